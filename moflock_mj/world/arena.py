"""The table `[arena]` of a scenario, and the registry of shapes.

A shape is a named tuple of numbers in a module of its own. Its type chooses the implementation of `locate_walls`, and
it has the methods of `Arena`. All other code asks an arena by these, and names no shape.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moflock_mj.errors import ScenarioError
from moflock_mj.fields import check_keys
from moflock_mj.world import circle, square


class Arena(Protocol):
    """What every arena answers; lengths in m, positions in the world frame."""

    @property
    def walls(self) -> int:
        """Rows that `locate_walls` writes for each drone."""
        ...

    @property
    def title(self) -> str:
        """The arena in a few words, such as "500 m arena"."""
        ...

    def outline(self) -> NDArray[np.float64]:
        """Corners of the boundary from above, anticlockwise: (V, 2)."""
        ...

    def extent(self) -> tuple[float, float]:
        """Half sides of the bounding box about the origin, along x and y."""
        ...

    def area(self) -> float:
        """m^2, from above."""
        ...

    def sample(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """Places that are uniform in the arena: (count, 2)."""
        ...

    def inset(self, margin: float) -> Arena:
        """The arena with every wall moved inwards by the margin; outwards if it is negative."""
        ...

    def distance_outside(self, position: ArrayLike) -> NDArray[np.float64]:
        """How far positions (..., 2 or 3) are beyond the boundary: (...); negative inside."""
        ...

    def circle(self) -> tuple[float, float, float] | None:
        """Centre x and y, and radius, of a round arena; None for one with corners."""
        ...


SHAPES: dict[str, Any] = {module.SHAPE: module for module in (square, circle)}
"""Modules of shapes by name. Each has `SHAPE`, the class `ARENA`, and `FIELDS`."""


class ArenaField(NamedTuple):
    """A number of a shape, in the table `[arena]`."""

    name: str
    unit: str
    meaning: str
    low: float
    high: float


def arena_fields(shape: str) -> tuple[ArenaField, ...]:
    """The numbers of a shape."""
    return tuple(ArenaField(*field) for field in SHAPES[shape].FIELDS)


def shape_of(arena: Any) -> str:
    """Name of an arena's shape.

    Raises:
        ScenarioError: it is no arena.
    """
    for name, module in SHAPES.items():
        if type(arena) is module.ARENA:
            return name
    raise ScenarioError(f"arena: {arena!r} is of the wrong type: it must be one of the shapes {', '.join(SHAPES)}")


def check_arena(arena: Any) -> Arena:
    """An arena whose numbers are floats within their bounds.

    Raises:
        ScenarioError: one line that names the field, the value and the limit.
    """
    shape = shape_of(arena)
    values = [_checked(field, value) for field, value in zip(arena_fields(shape), arena, strict=True)]
    return cast("Arena", type(arena)(*values))


def read_arena(table: Any) -> Arena:
    """An arena from its table: `shape`, and the numbers of that shape.

    Raises:
        ScenarioError: no table, an unknown shape, or see `check_arena`.
    """
    if not isinstance(table, Mapping):
        raise ScenarioError(f"arena: {table!r} is of the wrong type: it must be a table, [arena]")
    shape = table.get("shape")
    if shape not in SHAPES:
        raise ScenarioError(f"arena.shape: {shape!r} is unknown: it must be one of {', '.join(SHAPES)}")
    names = [field.name for field in arena_fields(shape)]
    check_keys(table, ["shape", *names], ScenarioError, "arena.")
    for name in names:
        if name not in table:
            raise ScenarioError(f"arena.{name}: is missing: a {shape} needs it")
    return check_arena(SHAPES[shape].ARENA(*(table[name] for name in names)))


def arena_table(arena: Any) -> dict[str, Any]:
    """The table of an arena, as `read_arena` reads it."""
    shape = shape_of(arena)
    return {"shape": shape, **dict(zip((field.name for field in arena_fields(shape)), arena, strict=True))}


def _checked(field: ArenaField, value: Any) -> float:
    name = f"arena.{field.name}"
    if isinstance(value, (bool, str)) or not hasattr(value, "__float__"):
        raise ScenarioError(f"{name}: {value!r} is of the wrong type: it must be a number")
    if not math.isfinite(value) or not field.low <= value <= field.high:
        limit = f"at least {field.low:g} {field.unit} and at most {field.high:g} {field.unit}"
        raise ScenarioError(f"{name}: {value!r} is out of bounds: it must be {limit}")
    return float(value)
