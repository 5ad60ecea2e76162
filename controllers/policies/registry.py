"""Registry of policies by name, and conversion of their parameters from and to numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, cast, get_type_hints

from controllers.policies.interface import PolicySpec
from controllers.policies.reynolds import REYNOLDS
from controllers.policies.target_tracking import TARGET_TRACKING
from controllers.policies.vasarhelyi import VASARHELYI

POLICIES = {spec.name: spec for spec in (VASARHELYI, TARGET_TRACKING, REYNOLDS)}
"""Policies by name. A policy in this registry can be flown, logged, searched and deployed."""

DEFAULT_POLICY = VASARHELYI.name


def spec_of(params: NamedTuple) -> PolicySpec:
    """Policy of the given parameters.

    Raises:
        TypeError: the parameters belong to no policy.
    """
    for spec in POLICIES.values():
        if type(params) is spec.params:
            return spec
    raise TypeError(f"{type(params).__name__} holds the parameters of no policy; known are {', '.join(POLICIES)}")


def values_of(params: NamedTuple) -> dict[str, float]:
    """Parameters as numbers by name, with those of a nested named tuple in its place."""
    values: dict[str, float] = {}
    for name, value in zip(params._fields, params, strict=True):
        values |= values_of(cast("NamedTuple", value)) if hasattr(value, "_fields") else {name: float(value)}
    return values


def make_params(spec: PolicySpec, numbers: Iterable[float]) -> NamedTuple:
    """Convert numbers to the parameter type of a policy.

    Args:
        spec: the policy.
        numbers: one number per parameter, in the order of `spec.parameters`.

    Raises:
        ValueError: the count of numbers is wrong.
    """
    numbers = tuple(numbers)
    if len(numbers) != len(spec.parameters):
        raise ValueError(f"{spec.name} has {len(spec.parameters)} parameters; there are {len(numbers)} numbers")
    return _fill(spec.params, iter(numbers))


def _fill(kind: Any, numbers: Iterator[float]) -> NamedTuple:
    hints = get_type_hints(kind)
    parts = [_fill(hints[name], numbers) if hasattr(hints[name], "_fields") else next(numbers) for name in kind._fields]
    return cast("NamedTuple", kind(*parts))
