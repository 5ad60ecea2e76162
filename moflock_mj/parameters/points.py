"""Parameter points: named points and JSON files."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from controllers.policies.interface import PolicySpec
from controllers.policies.registry import DEFAULT_POLICY, POLICIES, make_params, spec_of, values_of
from controllers.policies.target_tracking import TargetTrackingParams
from moflock_mj.errors import PointError, ScenarioError
from moflock_mj.fields import check_keys, real_number
from moflock_mj.files import read_limited

_FOLDER = Path(__file__).parent / "named_points"
"""Folder with one file per named point and its source. `make paper` writes fast, knee and cohesive, optimised on point
masses. `make physics` writes steady, which is flyable on rigid bodies. A, B and model_optimum are the paper's."""

_MAX_BYTES = 1 << 20
"""Largest size of a point file, bytes; a usual one has a few hundred."""

_MAX_SIZE = 1e6
"""Largest absolute value of a parameter."""


def point_names() -> tuple[str, ...]:
    """Names of the points in the package, see `load_point`."""
    return tuple(sorted((path.stem for path in _FOLDER.glob("*.json")), key=lambda name: (name.lower() != name, name)))


def load_point(name_or_path: str | Path) -> NamedTuple:
    """Load a named point, or a point from a JSON file.

    Example:
        >>> load_point("A").r0_rep
        33.6971443

    Args:
        name_or_path: name in `point_names`, or path of a .json file: an object of the parameters by name, or one with
            such an object as `params` and the name of the policy as `policy` ("vasarhelyi" if absent).

    Returns:
        The parameters in the type of the policy, such as `VasarhelyiParams`.

    Raises:
        PointError: unknown name, unreadable file, or not a point.
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
    """Registry entry of the policy with this name.

    Raises:
        PointError: the policy is unknown.
    """
    if not isinstance(name, str) or name not in POLICIES:
        raise PointError(f"policy: {name!r} is unknown: it must be one of {', '.join(POLICIES)}")
    return POLICIES[name]


def check_point(params: NamedTuple) -> NamedTuple:
    """Check the parameters of a policy, and convert them to floats.

    Raises:
        PointError: not the parameters of a policy, or see `point_from`.
    """
    try:
        spec = spec_of(params)
    except TypeError as problem:
        raise PointError(f"point: {problem}") from None
    return point_from(spec, _leaves(params))


def point_from(spec: PolicySpec, numbers: Iterable[Any]) -> NamedTuple:
    """Convert numbers in the order of `spec.parameters` to the parameter type of a policy.

    Raises:
        PointError: wrong count, not a number, not finite, too large, or not positive where the policy requires it.
    """
    values = tuple(numbers)
    if len(values) != len(spec.parameters):
        raise PointError(f"point: {len(values)} parameters; it must be {len(spec.parameters)}")
    for parameter, value in zip(spec.parameters, values, strict=True):
        name = parameter.name
        real_number(name, value, PointError)
        if abs(value) > _MAX_SIZE:
            raise PointError(f"{name}: {value!r} is out of bounds: it must be at most {_MAX_SIZE:g} in size")
        if parameter.positive and value <= 0:
            raise PointError(f"{name}: {value!r} is out of bounds: it must be over 0")
    return make_params(spec, map(float, values))


def point_from_values(spec: PolicySpec, values: Mapping[str, Any]) -> NamedTuple:
    """Convert numbers by name to the parameter type of a policy.

    Raises:
        PointError: an unknown or missing name, or see `point_from`.
    """
    check_keys(values, spec.names, PointError)
    missing = [name for name in spec.names if name not in values]
    if missing:
        raise PointError(f"{missing[0]}: missing")
    return point_from(spec, (values[name] for name in spec.names))


def with_target(params: Any, target: tuple[float, float], reach: float) -> TargetTrackingParams:
    """Add a target to the parameters of flocking.

    Args:
        params: parameters of flocking.
        target: (x, y) of the target, m, world.
        reach: largest absolute value of x and y, m.

    Raises:
        ScenarioError: the target is out of bounds.
        PointError: the policy of the point does not support a target.
    """
    for name, value in zip(("target_x", "target_y"), target, strict=True):
        if not abs(value) <= reach:
            raise ScenarioError(f"{name}: {value!r} m is out of bounds: it must be at most {reach:g} m in size")
    base: Any = check_point(params)
    if spec_of(base).name != DEFAULT_POLICY:
        raise PointError(f"policy: {spec_of(base).name!r} does not support a target: it must be {DEFAULT_POLICY}")
    return TargetTrackingParams(base, float(target[0]), float(target[1]))


def dump_point(params: NamedTuple) -> str:
    """Format a point as JSON, in the form of `load_point`."""
    return json.dumps({"policy": spec_of(params).name, "params": values_of(params)}, indent=1) + "\n"


def parse_point(content: Any) -> NamedTuple:
    """Create a point from a JSON value, see `load_point`.

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
