"""Bounds of the 12 parameters, and the unit cube that the algorithms see."""

from __future__ import annotations

import dataclasses
import json
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.policies.vasarhelyi import VasarhelyiParams
from moflock_mj.errors import PointError, SearchError
from moflock_mj.fields import check_keys
from moflock_mj.parameters.points import check_point

_LARGEST_FILE = 1 << 20
"""Bytes; a file of bounds has a few hundred."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Bounds:
    """The box in which points are searched.

    Attributes:
        lower: (12,), each in its parameter's unit, in the order of VasarhelyiParams.
        upper: (12,), each over its lower one.

    Raises:
        SearchError: not 12 pairs of finite numbers with lower under upper, or a bound that no policy can fly.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self) -> None:
        for side in ("lower", "upper"):
            try:
                object.__setattr__(self, side, tuple(check_point(getattr(self, side))))
            except PointError as problem:
                raise SearchError(f"bounds: {side} {problem}") from None
        for name, low, high in zip(VasarhelyiParams._fields, self.lower, self.upper, strict=True):
            if low >= high:
                raise SearchError(f"bounds: {name}: lower {low:g} must be under upper {high:g}")

    def check(self, point: VasarhelyiParams) -> None:
        """Refuse a point outside of the box.

        Raises:
            SearchError: which parameter is, and by which limit.
        """
        for name, value, low, high in zip(VasarhelyiParams._fields, point, self.lower, self.upper, strict=True):
            if not low <= value <= high:
                raise SearchError(f"{name}: {value!r} is out of bounds: it must be from {low:g} to {high:g}")

    def to_unit(self, points: ArrayLike) -> NDArray[np.float64]:
        """Points (..., 12) as unit-cube coordinates (..., 12): 0 at the lower bound, 1 at the upper."""
        lower, upper = np.array(self.lower), np.array(self.upper)
        return np.asarray((np.asarray(points, np.float64) - lower) / (upper - lower))

    def from_unit(self, unit: ArrayLike) -> NDArray[np.float64]:
        """Unit-cube coordinates (..., 12) as points (..., 12); what lies in the cube never leaves the bounds."""
        lower, upper = np.array(self.lower), np.array(self.upper)
        unit = np.asarray(unit, np.float64)
        # Rounding must not carry a coordinate of 1 beyond the upper bound, nor move what lies outside the cube.
        return np.where(unit == 1, upper, lower + unit * (upper - lower))

    def to_dict(self) -> dict[str, list[float]]:
        """`{name: [lower, upper]}`, as `bounds_of` reads it."""
        return {
            name: [low, high] for name, low, high in zip(VasarhelyiParams._fields, self.lower, self.upper, strict=True)
        }


def paper_bounds() -> Bounds:
    """The paper's bounds (its table of decision variables)."""
    return Bounds(
        lower=(30.8, 0.02, 58.5, 5.04, 0.38, 0.3, 0.03, -10.0, 10.0, 1.54, 0.48, 0.3),
        upper=(51.0, 0.1, 100.0, 10.0, 9.67, 2.7, 0.22, 0.0, 15.0, 6.55, 9.96, 1.0),
    )


def bounds_of(table: Any) -> Bounds:
    """Bounds from `{name: [lower, upper]}`; parameters that it does not name keep the paper's.

    Raises:
        SearchError: another name, or not a pair of numbers, or see `Bounds`.
    """
    if not isinstance(table, Mapping):
        raise SearchError("bounds: they must be a table of pairs, such as r0_rep = [30.8, 51.0]")
    check_keys(table, VasarhelyiParams._fields, SearchError)
    for name, pair in table.items():
        numbers = isinstance(pair, list) and all(
            isinstance(bound, (int, float)) and not isinstance(bound, bool) and math.isfinite(bound) for bound in pair
        )
        if not numbers or len(pair) != 2:
            raise SearchError(f"bounds: {name}: {pair!r} must be a pair of finite numbers, lower and upper")
    merged = paper_bounds().to_dict() | dict(table)
    lower, upper = zip(*(merged[name] for name in VasarhelyiParams._fields), strict=True)
    return Bounds(lower=lower, upper=upper)


def load_bounds(path: str | Path) -> Bounds:
    """Read a TOML or JSON file of lines such as `r0_rep = [30.8, 51.0]`; see `bounds_of`.

    Raises:
        SearchError: the file cannot be read, or holds no bounds.
    """
    path = Path(path)
    if path.suffix not in (".toml", ".json"):
        raise SearchError(f"bounds {path}: it must be a .toml or a .json file")
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise SearchError(f"bounds {path}: {path.stat().st_size} bytes; it must be at most {_LARGEST_FILE}")
        text = path.read_text(encoding="utf-8")
        return bounds_of(tomllib.loads(text) if path.suffix == ".toml" else json.loads(text))
    except OSError as problem:
        raise SearchError(f"bounds {path}: {problem.strerror}") from None
    except (ValueError, RecursionError) as problem:
        raise SearchError(f"bounds {path}: not {path.suffix[1:].upper()}: {problem}") from None
    except SearchError as problem:
        raise SearchError(f"bounds {path}: {problem}") from None
