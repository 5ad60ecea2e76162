"""Points: named sets of a policy's parameters, and JSON files of them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from controllers.policies.interface import PolicySpec
from controllers.policies.registry import DEFAULT_POLICY, POLICIES, make_params, spec_of, values_of
from controllers.policies.target_tracking import TargetTrackingParams
from moflock_mj.errors import PointError, ScenarioError
from moflock_mj.fields import check_keys
from moflock_mj.files import read_limited

_FOLDER = Path(__file__).parent / "named_points"
"""One file per named point, with its provenance. `make paper` writes fast, knee and cohesive, found on point masses;
`make physics` writes steady, which is flyable on bodies. A, B and model_optimum are the paper's."""

_MAX_BYTES = 1 << 20
"""Largest file of a point; a point has a few hundred bytes."""

_MAX_SIZE = 1e6
"""Largest size of a parameter."""


def point_names() -> tuple[str, ...]:
    """Names that `load_point` knows."""
    return tuple(sorted((path.stem for path in _FOLDER.glob("*.json")), key=lambda name: (name.lower() != name, name)))


def load_point(name_or_path: str | Path) -> NamedTuple:
    """A named point, or the point of a JSON file.

    Example:
        >>> load_point("A").r0_rep
        33.6971443

    Args:
        name_or_path: a name of `point_names`, or the path of a .json file: an object of the parameters by name, or one
            with such an object as `params` and the name of the policy as `policy` ("vasarhelyi" if absent).

    Returns:
        The parameters in the policy's own type, such as `NamedTuple`.

    Raises:
        PointError: no such name or file, or not a point.
    """
    path = Path(name_or_path)
    if path.suffix == ".json":
        return _read_point(path)
    if str(name_or_path) not in point_names():
        raise PointError(
            f"point {name_or_path}: unknown; it must be one of {', '.join(point_names())}, or a .json file"
        )
    return _read_point(_FOLDER / f"{name_or_path}.json")


def find_policy(name: Any) -> PolicySpec:
    """The policy of this name.

    Raises:
        PointError: there is none.
    """
    if not isinstance(name, str) or name not in POLICIES:
        raise PointError(f"policy: {name!r} is unknown: it must be one of {', '.join(POLICIES)}")
    return POLICIES[name]


def check_point(params: NamedTuple) -> NamedTuple:
    """The parameters of a policy, checked, as floats.

    Raises:
        PointError: not the parameters of a policy, or see `point_from`.
    """
    try:
        spec = spec_of(params)
    except TypeError as problem:
        raise PointError(f"point: {problem}") from None
    return point_from(spec, _leaves(params))


def point_from(spec: PolicySpec, numbers: Iterable[Any]) -> NamedTuple:
    """Parameters in the policy's own type, from numbers in the order of `spec.parameters`.

    Raises:
        PointError: too few or too many, not a number, not finite, too large, or outside of the policy's definition.
    """
    values = tuple(numbers)
    if len(values) != len(spec.parameters):
        raise PointError(f"point: {len(values)} parameters; it must be {len(spec.parameters)}")
    for parameter, value in zip(spec.parameters, values, strict=True):
        name = parameter.name
        if isinstance(value, (bool, str)) or not hasattr(value, "__float__"):
            raise PointError(f"{name}: {value!r} is of the wrong type: it must be a number")
        if not math.isfinite(value):
            raise PointError(f"{name}: {value!r} is not a finite number")
        if abs(value) > _MAX_SIZE:
            raise PointError(f"{name}: {value!r} is out of bounds: it must be at most {_MAX_SIZE:g} in size")
        if parameter.positive and value <= 0:
            raise PointError(f"{name}: {value!r} is out of bounds: it must be over 0")
    return make_params(spec, map(float, values))


def point_from_values(spec: PolicySpec, values: Mapping[str, Any]) -> NamedTuple:
    """Parameters in the policy's own type, from numbers by name.

    Raises:
        PointError: another name, a missing one, or see `point_from`.
    """
    check_keys(values, spec.names, PointError)
    missing = [name for name in spec.names if name not in values]
    if missing:
        raise PointError(f"{missing[0]}: missing")
    return point_from(spec, (values[name] for name in spec.names))


def with_target(params: Any, target: tuple[float, float], reach: float) -> TargetTrackingParams:
    """A point's parameters with a target around which the flock flies.

    Args:
        params: the parameters of flocking.
        target: (x, y), m, world.
        reach: m, how far from the origin x and y may be.

    Raises:
        ScenarioError: the target is out of reach.
        PointError: the point is of a policy that has no target.
    """
    for name, value in zip(("target_x", "target_y"), target, strict=True):
        if not abs(value) <= reach:
            raise ScenarioError(f"{name}: {value!r} m is out of bounds: it must be at most {reach:g} m in size")
    base: Any = check_point(params)
    if spec_of(base).name != DEFAULT_POLICY:
        raise PointError(f"policy: {spec_of(base).name!r} has no target: it must be {DEFAULT_POLICY}")
    return TargetTrackingParams(base, float(target[0]), float(target[1]))


def dump_point(params: NamedTuple) -> str:
    """The point as JSON, as `load_point` reads it."""
    return json.dumps({"policy": spec_of(params).name, "params": values_of(params)}, indent=1) + "\n"


def parse_point(content: Any) -> NamedTuple:
    """The point of a JSON value, see `load_point`.

    Raises:
        PointError: not a point.
    """
    named = content.get("params", content) if isinstance(content, Mapping) else content
    if not isinstance(named, Mapping):
        raise PointError("it must be an object of the parameters by name")
    policy = content.get("policy", DEFAULT_POLICY) if "params" in content else DEFAULT_POLICY
    return point_from_values(find_policy(policy), named)


def _leaves(params: Any) -> Iterable[Any]:
    for value in params:
        if hasattr(value, "_fields"):
            yield from _leaves(value)
        else:
            yield value


def _read_point(path: Path) -> NamedTuple:
    try:
        content = json.loads(read_limited(path, _MAX_BYTES).decode("utf-8"))
    except OSError as problem:
        raise PointError(f"point {path}: {problem.strerror}") from None
    except (ValueError, RecursionError) as problem:
        raise PointError(f"point {path}: not JSON: {problem}") from None
    try:
        return parse_point(content)
    except PointError as problem:
        raise PointError(f"point {path}: {problem}") from None
