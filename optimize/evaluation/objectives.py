"""Objectives of a search: products of groups of fitnesses."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moflock_mj.errors import ScenarioError, SearchError
from moflock_mj.metrics.catalogue import METRICS
from moflock_mj.metrics.fitness import Fitness
from moflock_mj.scenario.scenario import Scenario

FITNESS_NAMES = tuple(metric.fitness for metric in METRICS)
"""Columns of an evaluation's fitness."""

COVERAGE = "coverage"
"""Name of the optional seventh column."""

_LARGEST_FILE = 1 << 20
_NUMERICAL = ("step", "airframe", "verdict")
"""Fields of a scenario that do not change the grouping of its fitnesses."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Objectives:
    """Objectives to be maximised, each the product of a group of fitnesses.

    Attributes:
        groups: (K,), the names of the fitnesses of each objective, from FITNESS_NAMES or "coverage".
        names: (K,), such as F_1, F_2.
        scenario: the scenario for which the groups were found; None if they apply to any scenario.

    Raises:
        SearchError: there is no group, a group is empty, a fitness is unknown or repeated, or the names do not match.
    """

    groups: tuple[tuple[str, ...], ...]
    names: tuple[str, ...]
    scenario: Scenario | None = None

    def __post_init__(self) -> None:
        if not self.groups or not all(self.groups):
            raise SearchError("objectives: each must have at least one fitness")
        if len(self.names) != len(self.groups) or len(set(self.names)) != len(self.names):
            raise SearchError(f"objectives: {len(self.groups)} groups must have as many different names: {self.names}")
        members = [name for group in self.groups for name in group]
        for name in members:
            if name not in (*FITNESS_NAMES, COVERAGE):
                known = ", ".join((*FITNESS_NAMES, COVERAGE))
                raise SearchError(f"objectives: {name!r}: unknown fitness; it must be one of {known}")
            if members.count(name) > 1:
                count = members.count(name)
                raise SearchError(f"objectives: {name}: it is given {count} times; it must be in one objective only")

    @property
    def coverage(self) -> bool:
        """Whether an objective needs the coverage."""
        return any(COVERAGE in group for group in self.groups)

    def of(self, fitness: Fitness | Mapping[str, ArrayLike]) -> NDArray[np.float64]:
        """Objectives (..., K) of fitnesses given by name, each a number or an array (...)."""
        named = fitness._asdict() if isinstance(fitness, Fitness) else fitness
        products = [np.prod([np.asarray(named[name], np.float64) for name in group], axis=0) for group in self.groups]
        return np.stack(products, axis=-1)

    def of_columns(self, fitness: ArrayLike) -> NDArray[np.float64]:
        """Objectives (..., K) of the fitness columns (..., 6), or (..., 7) with coverage."""
        columns = np.moveaxis(np.asarray(fitness, np.float64), -1, 0)
        return self.of(dict(zip((*FITNESS_NAMES, COVERAGE), columns, strict=False)))

    def single(self) -> Objectives:
        """A single objective, the product of all groups, for single-objective algorithms."""
        members = tuple(name for group in self.groups for name in group)
        return Objectives(groups=(members,), names=("product",), scenario=self.scenario)

    def with_coverage(self) -> Objectives:
        """The same objectives with coverage as an additional fitness of the first group."""
        first, *others = self.groups
        return dataclasses.replace(self, groups=((*first, COVERAGE), *others))

    def to_json(self) -> str:
        """JSON text that `from_json` reads."""
        content: dict[str, Any] = {"objectives": dict(zip(self.names, map(list, self.groups), strict=True))}
        if self.scenario is not None:
            content["scenario"] = self.scenario.to_dict()
        return json.dumps(content, indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Objectives:
        """Read `{"objectives": {"F_1": ["wall", "speed"], ...}, "scenario": {...}}`.

        Raises:
            SearchError: the text has another form.
        """
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise SearchError(f"objectives: not JSON: {error}") from None
        groups = content.get("objectives") if isinstance(content, Mapping) else None
        if not isinstance(groups, Mapping) or not all(
            isinstance(group, list) and all(isinstance(name, str) for name in group) for group in groups.values()
        ):
            raise SearchError('objectives: it must be an object such as {"objectives": {"F_1": ["wall", "speed"]}}')
        return cls(
            groups=tuple(tuple(group) for group in groups.values()),
            names=tuple(groups),
            scenario=_scenario_of(content.get("scenario")),
        )


PAPER = Objectives(
    groups=tuple(tuple(metric.fitness for metric in METRICS if metric.group == group) for group in (1, 2)),
    names=("F_1", "F_2"),
)
"""The paper's two objectives."""


def load_objectives(path: str | Path, scenario: Scenario) -> Objectives:
    """Read a file of objectives that were found for `scenario`, or apply to any scenario.

    Raises:
        SearchError: the file cannot be read, holds no objectives, or was made for another scenario.
    """
    path = Path(path)
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise SearchError(f"{path.stat().st_size} bytes; it must be at most {_LARGEST_FILE}")
        objectives = Objectives.from_json(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SearchError(f"objectives {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise SearchError(f"objectives {path}: it is not UTF-8 text") from None
    except SearchError as error:
        raise SearchError(f"objectives {path}: {str(error).removeprefix('objectives: ')}") from None
    if objectives.scenario is not None:
        _check_same(path, objectives.scenario, scenario)
    return objectives


def _check_same(path: Path, stored: Scenario, current: Scenario) -> None:
    for name in Scenario.field_names():
        found, required = getattr(stored, name), getattr(current, name)
        if found != required and name not in _NUMERICAL:
            raise SearchError(
                f"objectives {path}: found for another scenario: {name} is {found} there: it must be {required}"
            )


def _scenario_of(fields: Any) -> Scenario | None:
    if fields is None:
        return None
    if not isinstance(fields, Mapping):
        raise SearchError("objectives: scenario: it must be an object with the fields of a scenario")
    try:
        return Scenario.from_dict(fields)
    except ScenarioError as error:
        raise SearchError(f"objectives: scenario: {error}") from None
