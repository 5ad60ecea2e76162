"""Bounds of a policy's parameters, and scaling to the unit cube of the search algorithms."""

from __future__ import annotations

import dataclasses
import json
import math
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.policies.interface import PolicySpec
from controllers.policies.registry import DEFAULT_POLICY, make_params, spec_of, values_of
from moflock_mj.errors import PointError, SearchError
from moflock_mj.fields import check_keys
from moflock_mj.files import read_limited
from moflock_mj.parameters.points import find_policy, point_from

_MAX_BYTES = 1 << 20
"""Largest size of a bounds file, bytes; a usual one has a few hundred."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ParameterBounds:
    """Bounds of the parameters of a policy in a search.

    Attributes:
        policy: name of the policy.
        lower: (D,), lower bounds in the units and the order of the policy's parameters.
        upper: (D,), upper bounds.

    Raises:
        SearchError: not D pairs of finite numbers with lower under upper, or a bound that the policy does not accept.
    """

    policy: str = DEFAULT_POLICY
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self) -> None:
        for side in ("lower", "upper"):
            try:
                values = values_of(point_from(self.spec, getattr(self, side)))
            except PointError as problem:
                raise SearchError(f"bounds: {side} {problem}") from None
            object.__setattr__(self, side, tuple(values.values()))
        for name, low, high in zip(self.spec.names, self.lower, self.upper, strict=True):
            if low >= high:
                raise SearchError(f"bounds: {name}: lower {low:g} must be under upper {high:g}")

    @property
    def spec(self) -> PolicySpec:
        """Registry entry of the policy."""
        return find_policy(self.policy)

    def params(self, point: Iterable[float]) -> NamedTuple:
        """Convert a point (D,) to the parameter type of the policy, without checks."""
        return make_params(self.spec, map(float, point))

    def check(self, point: NamedTuple) -> None:
        """Check that a point belongs to the policy and lies within the bounds.

        Raises:
            SearchError: a point of another policy, or a parameter out of bounds.
        """
        if spec_of(point).name != self.policy:
            raise SearchError(f"policy: {spec_of(point).name!r} is not that of the bounds: it must be {self.policy!r}")
        values = values_of(point).values()
        for name, value, low, high in zip(self.spec.names, values, self.lower, self.upper, strict=True):
            if not low <= value <= high:
                raise SearchError(f"{name}: {value!r} is out of bounds: it must be from {low:g} to {high:g}")

    def to_unit(self, points: ArrayLike) -> NDArray[np.float64]:
        """Scale points (..., D) to unit-cube coordinates (..., D): 0 at the lower bound, 1 at the upper."""
        lower, upper = np.array(self.lower), np.array(self.upper)
        return np.asarray((np.asarray(points, np.float64) - lower) / (upper - lower))

    def from_unit(self, unit: ArrayLike) -> NDArray[np.float64]:
        """Scale unit-cube coordinates (..., D) to points (..., D), which stay within the bounds."""
        lower, upper = np.array(self.lower), np.array(self.upper)
        unit = np.asarray(unit, np.float64)
        # A coordinate of 1 gives the upper bound exactly: rounding could exceed it.
        return np.where(unit == 1, upper, lower + unit * (upper - lower))

    def to_dict(self) -> dict[str, list[float]]:
        """Bounds as `{name: [lower, upper]}`, in the form of `bounds_of`."""
        pairs = zip(self.spec.names, self.lower, self.upper, strict=True)
        return {name: [low, high] for name, low, high in pairs}


def policy_bounds(policy: str = DEFAULT_POLICY) -> ParameterBounds:
    """Default bounds of a policy; for Vasarhelyi's those of the paper.

    Raises:
        PointError: the policy is unknown.
    """
    spec = find_policy(policy)
    return ParameterBounds(
        policy=policy,
        lower=tuple(parameter.low for parameter in spec.parameters),
        upper=tuple(parameter.high for parameter in spec.parameters),
    )


def bounds_of(table: Any, policy: str = DEFAULT_POLICY) -> ParameterBounds:
    """Create bounds from `{name: [lower, upper]}`; absent parameters keep the default bounds of the policy.

    Raises:
        SearchError: an unknown name, not a pair of numbers, or see `ParameterBounds`.
    """
    if not isinstance(table, Mapping):
        raise SearchError("bounds: they must be a table of pairs, such as r0_rep = [30.8, 51.0]")
    merged = policy_bounds(policy).to_dict()
    check_keys(table, merged, SearchError)
    for name, pair in table.items():
        numbers = isinstance(pair, list) and all(
            isinstance(bound, (int, float)) and not isinstance(bound, bool) and math.isfinite(bound) for bound in pair
        )
        if not numbers or len(pair) != 2:
            raise SearchError(f"bounds: {name}: {pair!r} must be a pair of finite numbers, lower and upper")
    lower, upper = zip(*(merged | dict(table)).values(), strict=True)
    return ParameterBounds(policy=policy, lower=lower, upper=upper)


def load_bounds(path: str | Path) -> ParameterBounds:
    """Read bounds from a TOML or JSON file with entries such as `r0_rep = [30.8, 51.0]`; see `bounds_of`.

    An entry such as `policy = "vasarhelyi"` names the policy.

    Raises:
        SearchError: the file cannot be read, or does not contain bounds.
    """
    path = Path(path)
    if path.suffix not in (".toml", ".json"):
        raise SearchError(f"bounds {path}: it must be a .toml or a .json file")
    try:
        text = read_limited(path, _MAX_BYTES).decode("utf-8")
        table = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
        policy = table.pop("policy", DEFAULT_POLICY) if isinstance(table, dict) else DEFAULT_POLICY
        return bounds_of(table, policy)
    except OSError as problem:
        raise SearchError(f"bounds {path}: {problem.strerror}") from None
    except (ValueError, RecursionError) as problem:
        raise SearchError(f"bounds {path}: not {path.suffix[1:].upper()}: {problem}") from None
    except (SearchError, PointError) as problem:
        raise SearchError(f"bounds {path}: {problem}") from None
