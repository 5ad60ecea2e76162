"""Configuration of a search: all inputs on which its result depends."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.policies.registry import DEFAULT_POLICY, values_of
from moflock_mj.errors import PointError, ScenarioError, SearchError
from moflock_mj.fields import check_fields, check_keys, quantity
from moflock_mj.parameters.bounds import ParameterBounds, bounds_of, policy_bounds
from moflock_mj.parameters.points import find_policy, point_from
from moflock_mj.scenario.scenario import Scenario
from optimize.evaluation.archive import installed_versions
from optimize.evaluation.evaluation import Job, search_scenario
from optimize.evaluation.objectives import PAPER, Objectives

ALGORITHMS = ("nsga2", "unsga3", "cmaes", "pso")


SINGLE_OBJECTIVE = ("cmaes", "pso")
"""Algorithms that maximise the product of all objectives."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SearchConfig:
    """Settings of a search.

    Raises:
        SearchError: a value has the wrong type or is out of bounds, or a combination of values is invalid.
    """

    algorithm: str = quantity("nsga2", "1", "search algorithm", choices=ALGORITHMS)
    dynamics: str = quantity("point_mass", "1", "model of the drones' motion", choices=("point_mass", "rigid_body"))
    noise: str = quantity(
        "refly",
        "1",
        "fixed: the same seeds for all flights, as in the paper; common: new seeds for each generation; refly: new "
        "seeds for each evaluation. With common and refly, leaders fly again and a Gaussian process averages noise",
        choices=("fixed", "common", "refly"),
    )
    seeds: int = quantity(1, "1", "flights per evaluation", low=1, high=1000)
    seed: int = quantity(1, "1", "seed of all random numbers of the search", low=0, high=2**31)
    population: int = quantity(50, "1", "points per generation", low=4, high=10_000)
    budget: int = quantity(2000, "1", "number of flights", low=1, high=10_000_000)
    unbounded: bool = quantity(False, "1", "whether cmaes may leave the bounds")
    screen: bool = quantity(False, "1", "whether all offspring fly as point masses, and only the best as rigid bodies")
    timeout: float | None = quantity(600.0, "s", "wall time limit of an evaluation", low=0, open_low=True, high=1e6)

    def __post_init__(self) -> None:
        check_fields(self, SearchError)
        if self.unbounded and self.algorithm != "cmaes":
            raise SearchError(f"unbounded: only cmaes can leave the bounds; the algorithm is {self.algorithm}")
        if self.screen and self.dynamics != "rigid_body":
            raise SearchError(f"screen: it is for the dynamics rigid_body; they are {self.dynamics}")
        if self.screen and (self.algorithm in SINGLE_OBJECTIVE or self.noise == "fixed"):
            raise SearchError(
                "screen: it requires nsga2 or unsga3 with the noise refly or common; "
                f"they are {self.algorithm} and {self.noise}"
            )
        if self.budget < self.population * self.seeds:
            needed = self.population * self.seeds
            raise SearchError(f"budget: {self.budget} flights; it must be at least one generation, {needed}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Configuration:
    """Resolved configuration of a search: all inputs on which its result depends.

    Attributes:
        scenario: scenario of the flights.
        bounds: bounds of the parameters.
        objectives: objectives to be maximised; cmaes and pso maximise their product.
        settings: settings of the search.
        start: points of the first generation; random points complete it.
        versions: versions of the libraries.

    Raises:
        SearchError: a multi-objective algorithm has a single objective, or the start points are unsuitable.
    """

    scenario: Scenario = dataclasses.field(default_factory=Scenario)
    bounds: ParameterBounds = dataclasses.field(default_factory=policy_bounds)
    objectives: Objectives = PAPER
    settings: SearchConfig = dataclasses.field(default_factory=SearchConfig)
    start: tuple[NamedTuple, ...] = ()
    versions: Mapping[str, str] = dataclasses.field(default_factory=installed_versions)

    def __post_init__(self) -> None:
        if self.settings.algorithm not in SINGLE_OBJECTIVE and len(self.objectives.names) < 2:
            raise SearchError(f"objectives: {self.settings.algorithm} there is one; it must be at least two")
        if self.start and self.settings.algorithm in SINGLE_OBJECTIVE:
            raise SearchError(f"start: it requires nsga2 or unsga3; the algorithm is {self.settings.algorithm}")
        if len(self.start) > self.settings.population:
            raise SearchError(
                f"start: {len(self.start)} points; it must be at most the population, {self.settings.population}"
            )
        for point in self.start:
            try:
                self.bounds.check(point)
            except SearchError as error:
                raise SearchError(f"start: {error}") from None

    @property
    def job(self) -> Job:
        """Job of the executor."""
        return Job(
            scenario=self.scenario,
            dynamics=self.settings.dynamics,
            policy=self.bounds.policy,
            coverage=self.objectives.coverage,
            timeout=self.settings.timeout,
        )

    @property
    def screening_job(self) -> Job | None:
        """Job of the executor that screens on point masses; None without screening."""
        if not self.settings.screen:
            return None
        scenario = search_scenario(self.scenario, "point_mass")
        return dataclasses.replace(self.job, scenario=scenario, dynamics="point_mass")

    @property
    def maximised(self) -> Objectives:
        """Objectives that the algorithm maximises."""
        return self.objectives.single() if self.settings.algorithm in SINGLE_OBJECTIVE else self.objectives

    def start_units(self) -> NDArray[np.float64] | None:
        """Start points (m, D) in the unit cube; None if there are none."""
        if not self.start:
            return None
        return self.bounds.to_unit([list(values_of(point).values()) for point in self.start])

    def replace(self, **changes: Any) -> Configuration:
        """Copy of the configuration with changed fields."""
        return dataclasses.replace(self, **changes)

    def to_json(self) -> str:
        """JSON text of all fields but the scenario, which is stored as a TOML file that `moflock fly` also reads."""
        content: dict[str, Any] = {"settings": dataclasses.asdict(self.settings)}
        content["policy"] = self.bounds.policy
        content["bounds"] = self.bounds.to_dict()
        content["objectives"] = dict(zip(self.objectives.names, map(list, self.objectives.groups), strict=True))
        content["start"] = [list(values_of(point).values()) for point in self.start]
        content["versions"] = dict(self.versions)
        return json.dumps(content, indent=1) + "\n"

    @classmethod
    def from_texts(cls, configuration: str, scenario: str) -> Configuration:
        """Read the texts that `to_json` and the scenario's `to_toml` wrote.

        Raises:
            SearchError: the texts have another form.
        """
        try:
            content = json.loads(configuration)
            flown = Scenario.from_toml(scenario)
        except (ValueError, RecursionError) as error:
            raise SearchError(f"configuration: not JSON: {error}") from None
        except ScenarioError as error:
            raise SearchError(f"scenario: {error}") from None
        if not isinstance(content, Mapping):
            raise SearchError("configuration: it must be an object")
        parts = ("settings", "bounds", "objectives", "versions")
        check_keys(content, (*parts, "policy", "start"), SearchError)
        for name in parts:
            if not isinstance(content.get(name), Mapping):
                raise SearchError(f"configuration: {name}: it must be an object")
        check_keys(content["settings"], [field.name for field in dataclasses.fields(SearchConfig)], SearchError)
        bounds = bounds_of(content["bounds"], _policy_of(content.get("policy", DEFAULT_POLICY)))
        return cls(
            scenario=flown,
            bounds=bounds,
            objectives=Objectives.from_json(json.dumps({"objectives": content["objectives"]})),
            settings=SearchConfig(**content["settings"]),
            start=_points_of(content.get("start", []), bounds),
            versions=content["versions"],
        )


def _policy_of(name: Any) -> str:
    try:
        return find_policy(name).name
    except PointError as error:
        raise SearchError(f"configuration: {error}") from None


def _points_of(rows: Any, bounds: ParameterBounds) -> tuple[NamedTuple, ...]:
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        raise SearchError("configuration: start: it must be a list of points, each a list of numbers")
    try:
        return tuple(point_from(bounds.spec, row) for row in rows)
    except PointError as error:
        raise SearchError(f"configuration: start: {error}") from None
