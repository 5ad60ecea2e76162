"""Table `[arena]` of a scenario, and registry of arena shapes.

A shape is a named tuple of numbers in a module of its own, with the methods of `Arena` and an implementation of
`locate_walls`. All other code uses these and does not depend on the shape.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moflock_mj.errors import ScenarioError
from moflock_mj.fields import check_keys, real_number
from moflock_mj.world import circle, square


class Arena(Protocol):
    """Interface of an arena; lengths in m, positions in the world frame."""

    @property
    def walls(self) -> int:
        """Number of walls W that `locate_walls` writes for each drone."""
        ...

    @property
    def title(self) -> str:
        """Short description, such as "500 m arena"."""
        ...

    def outline(self) -> NDArray[np.float64]:
        """Corners of the boundary from above, anticlockwise: (V, 2)."""
        ...

    def extent(self) -> tuple[float, float]:
        """Half sides of the bounding box about the origin, along x and y."""
        ...

    def area(self) -> float:
        """Area, m^2."""
        ...

    def sample(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        """Sample positions uniformly in the arena: (count, 2)."""
        ...

    def inset(self, margin: float) -> Arena:
        """Arena with every wall moved inwards by the margin, or outwards if it is negative."""
        ...

    def distance_outside(self, position: ArrayLike) -> NDArray[np.float64]:
        """Distance of positions (..., 2 or 3) beyond the boundary: (...); negative inside."""
        ...

    def circle(self) -> tuple[float, float, float] | None:
        """Centre x, centre y and radius of a round arena; None for a polygon."""
        ...


SHAPES: dict[str, Any] = {module.SHAPE: module for module in (square, circle)}
"""Modules of shapes by name. Each module defines `SHAPE`, the class `ARENA`, and `FIELDS`."""


class ArenaField(NamedTuple):
    """Field of a shape in the table `[arena]`."""

    name: str
    unit: str
    meaning: str
    low: float
    high: float


def arena_fields(shape: str) -> tuple[ArenaField, ...]:
    """Fields of a shape."""
    return tuple(ArenaField(*field) for field in SHAPES[shape].FIELDS)


def shape_of(arena: Any) -> str:
    """Name of an arena's shape.

    Raises:
        ScenarioError: not an arena.
    """
    for name, module in SHAPES.items():
        if type(arena) is module.ARENA:
            return name
    raise ScenarioError(f"arena: {arena!r} is of the wrong type: it must be one of the shapes {', '.join(SHAPES)}")


def check_arena(arena: Any) -> Arena:
    """Check the fields of an arena, and convert them to floats.

    Raises:
        ScenarioError: one line that names the field, the value and the limit.
    """
    shape = shape_of(arena)
    values = [_checked(field, value) for field, value in zip(arena_fields(shape), arena, strict=True)]
    return cast("Arena", type(arena)(*values))


def read_arena(table: Any) -> Arena:
    """Create an arena from its table: `shape`, and the fields of that shape.

    Raises:
        ScenarioError: not a table, an unknown shape, or see `check_arena`.
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
    """Table of an arena, in the form of `read_arena`."""
    shape = shape_of(arena)
    return {"shape": shape, **dict(zip((field.name for field in arena_fields(shape)), arena, strict=True))}


def _checked(field: ArenaField, value: Any) -> float:
    name = f"arena.{field.name}"
    number = real_number(name, value, ScenarioError)
    if not field.low <= number <= field.high:
        limit = f"at least {field.low:g} {field.unit} and at most {field.high:g} {field.unit}"
        raise ScenarioError(f"{name}: {value!r} is out of bounds: it must be {limit}")
    return number
