"""Points: named sets of the policy's 12 parameters, and JSON files of them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from controllers.policies.target_tracking import TargetTrackingParams
from controllers.policies.vasarhelyi import VasarhelyiParams
from moflock_mj.errors import PointError, ScenarioError
from moflock_mj.fields import check_keys

_PAPER_POINTS = {
    # The original model's optimum at 6 m/s (Vasarhelyi et al. 2018), X_a in the paper; outside the paper's bounds.
    "model_optimum": VasarhelyiParams(41.1, 0.07, 88.5, 9.94, 5.32, 0.93, 0.05, 0.5, 19.7, 3.54, 5.44, 1.0),
    # The two ends of the paper's front, with the digits that its authors published (the printed B has misprints).
    "A": VasarhelyiParams(
        33.6971443, 0.023683433, 59.2608031, 5.38039876, 4.62063792, 1.7334826,
        0.0352457821, -2.45024732, 12.9383823, 4.84342556, 4.83207547, 0.55557394,
    ),
    "B": VasarhelyiParams(
        33.4531599, 0.0284441546, 58.9520177, 8.2233046, 2.67682789, 0.300404844,
        0.184166142, -0.21348317, 12.9389626, 2.57143904, 1.30148574, 0.431371072,
    ),
}  # fmt: skip

_OWN_POINTS = ("fast", "knee", "cohesive", "steady")
"""Points that our own searches have found; `named_points/` has each with its provenance. `make paper` writes the first
three, found on point masses, and `make physics` the last, which is flyable on bodies."""

_OWN_FOLDER = Path(__file__).parent / "named_points"

_MUST_BE_POSITIVE = ("a_frict", "p_frict", "a_shill", "p_shill")
"""The braking curve divides by its slope and brakes by its acceleration."""

_LARGEST_FILE = 1 << 20
"""Bytes; a point is a few hundred."""


def point_names() -> tuple[str, ...]:
    """Names that `named_point` knows."""
    return (*_OWN_POINTS, *_PAPER_POINTS)


def named_point(name: str) -> VasarhelyiParams:
    """A point of the paper's, or one of our own: "fast", "knee", "cohesive" or "steady".

    Raises:
        PointError: another name.
    """
    if name in _OWN_POINTS:
        return _read_point(_OWN_FOLDER / f"{name}.json")
    if name not in _PAPER_POINTS:
        raise PointError(f"point {name}: unknown; it must be one of {', '.join(point_names())}, or a .json file")
    return _PAPER_POINTS[name]


def paper_point(name: str) -> VasarhelyiParams:
    """One of the paper's points: "A", "B" or "model_optimum".

    Raises:
        PointError: another name.
    """
    if name not in _PAPER_POINTS:
        raise PointError(f"point {name}: unknown; known are {', '.join(_PAPER_POINTS)}")
    return _PAPER_POINTS[name]


def check_point(values: Any) -> VasarhelyiParams:
    """The 12 parameters as floats, in the policy's own type.

    Args:
        values: a VasarhelyiParams, or 12 numbers in its order.

    Raises:
        PointError: not 12 numbers, one of them not finite, or a braking curve that is none.
    """
    numbers = tuple(values)
    if len(numbers) != len(VasarhelyiParams._fields):
        raise PointError(f"point: {len(numbers)} parameters; it must be {len(VasarhelyiParams._fields)}")
    for name, value in zip(VasarhelyiParams._fields, numbers, strict=True):
        if isinstance(value, (bool, str)) or not hasattr(value, "__float__"):
            raise PointError(f"{name}: {value!r} is of the wrong type: it must be a number")
        if not math.isfinite(value):
            raise PointError(f"{name}: {value!r} is not a finite number")
        if abs(value) > 1e6:
            raise PointError(f"{name}: {value!r} is out of bounds: it must be at most 1e+06 in size")
        if name in _MUST_BE_POSITIVE and value <= 0:
            raise PointError(f"{name}: {value!r} is out of bounds: it must be over 0")
    return VasarhelyiParams(*(float(value) for value in numbers))


def with_target(params: VasarhelyiParams, target: tuple[float, float], reach: float) -> VasarhelyiParams:
    """A point's parameters and a target to loiter around, as a flight takes them: `TargetTrackingParams`.

    A flight asks its parameters for the 12 by their names, and its loop for their type, which chooses the policy.

    Args:
        params: the 12 parameters.
        target: (x, y), m, world.
        reach: m, how far from the origin x and y may be.

    Raises:
        ScenarioError: the target is out of reach.
    """
    for name, value in zip(("target_x", "target_y"), target, strict=True):
        if not abs(value) <= reach:
            raise ScenarioError(f"{name}: {value!r} m is out of bounds: it must be at most {reach:g} m in size")
    return cast("VasarhelyiParams", TargetTrackingParams.of(check_point(params), target))


def load_point(name_or_path: str) -> VasarhelyiParams:
    """A named point, or the point of a JSON file: an object of the 12 names, or one with such an object as `params`.

    Raises:
        PointError: no such name or file, or not a point.
    """
    path = Path(name_or_path)
    return _read_point(path) if path.suffix == ".json" else named_point(name_or_path)


def dump_point(params: VasarhelyiParams) -> str:
    """The point as JSON, as `load_point` reads it."""
    return json.dumps({"params": params._asdict()}, indent=1) + "\n"


def _read_point(path: Path) -> VasarhelyiParams:
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise PointError(f"point {path}: {path.stat().st_size} bytes; it must be at most {_LARGEST_FILE}")
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise PointError(f"point {path}: {problem.strerror}") from None
    except (ValueError, RecursionError) as problem:
        raise PointError(f"point {path}: not JSON: {problem}") from None
    try:
        return _point_of(content)
    except PointError as problem:
        raise PointError(f"point {path}: {problem}") from None


def _point_of(content: Any) -> VasarhelyiParams:
    named = content.get("params", content) if isinstance(content, Mapping) else content
    if not isinstance(named, Mapping):
        raise PointError("it must be an object of the 12 parameters' names")
    check_keys(named, VasarhelyiParams._fields, PointError)
    missing = [name for name in VasarhelyiParams._fields if name not in named]
    if missing:
        raise PointError(f"{missing[0]}: missing")
    return check_point(named[name] for name in VasarhelyiParams._fields)
