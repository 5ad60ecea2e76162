"""Validation: points flown on point masses and on rigid bodies with the same seeds, in a directory that resumes."""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.policies.interface import PolicySpec
from controllers.policies.registry import DEFAULT_POLICY, POLICIES, spec_of, values_of
from moflock_mj.dynamics.airframe_models import load_airframe
from moflock_mj.errors import PointError, SearchError
from moflock_mj.flight import fly
from moflock_mj.metrics.verdict import Verdict, judge
from moflock_mj.parameters.points import find_policy, point_from_values
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulation.simulation import Simulation
from optimize.evaluation.archive import Archive, installed_versions, read_directory, write_directory
from optimize.evaluation.batch import ProgressCallback, fresh_seeds
from optimize.evaluation.evaluation import (
    FIGURE_NAMES,
    OK,
    Evaluation,
    EvaluationTask,
    Job,
    figure_columns,
    search_scenario,
)
from optimize.evaluation.interface import Executor
from optimize.evaluation.objectives import PAPER
from optimize.search.estimates import non_dominated
from optimize.search.parameter_sources import read_points
from optimize.validation.fault_trials import FaultTrial, fault_trials, standard_faults

DYNAMICS = ("point_mass", "rigid_body")
POINT_MASS, RIGID_BODY = 0, 1
"""Indices of the first axis of a validation's arrays."""

SEEDS = 20

FAULT_SEEDS = 5
"""Flights of each point with each fault, where faults are wanted and nothing else is said."""

_MAX_SEEDS = 10_000


@dataclasses.dataclass(frozen=True, kw_only=True)
class ValidationConfig:
    """What is validated: everything that the result depends on.

    Attributes:
        scenario: what is flown; without a step, bodies take their own and point masses that of searches.
        points: by name.
        seeds: (S,), the same for all points and both dynamics.
        fault_seeds: how many of these each point flies with each of the standard faults, on bodies; 0 for no faults.
        versions: of the libraries.

    Raises:
        SearchError: no points, points of several policies, or too few or too many seeds.
    """

    scenario: Scenario
    points: Mapping[str, NamedTuple]
    seeds: tuple[int, ...]
    fault_seeds: int = 0
    versions: Mapping[str, str] = dataclasses.field(default_factory=installed_versions)

    def __post_init__(self) -> None:
        if not self.points:
            raise SearchError("points: there is none; it must be at least 1")
        policies = {spec_of(params).name for params in self.points.values()}
        if len(policies) > 1:
            raise SearchError(f"points: they are of the policies {', '.join(sorted(policies))}; it must be one")
        check_seeds(len(self.seeds))
        if not 0 <= self.fault_seeds <= len(self.seeds):
            raise SearchError(
                f"fault_seeds: {self.fault_seeds} is out of bounds: it must be at least 0 and at most {len(self.seeds)}"
            )

    @property
    def policy(self) -> str:
        """Name of the points' policy."""
        return spec_of(next(iter(self.points.values()))).name

    @property
    def faults(self) -> dict[str, Scenario]:
        """The scenario with each of the standard faults, by name; none if none are wanted."""
        return standard_faults(self.jobs()[RIGID_BODY].scenario) if self.fault_seeds else {}

    def jobs(self) -> tuple[Job, Job]:
        """What the executors need to know, in the order of DYNAMICS; the variants are the faults'."""
        point_mass, rigid_body = (
            Job(scenario=search_scenario(self.scenario, dynamics), dynamics=dynamics, policy=self.policy)
            for dynamics in DYNAMICS
        )
        variants = tuple(standard_faults(rigid_body.scenario).values()) if self.fault_seeds else ()
        return point_mass, dataclasses.replace(rigid_body, variants=variants)

    def tasks(self) -> tuple[list[EvaluationTask], list[EvaluationTask]]:
        """One flight each, in the order of DYNAMICS, with consecutive numbers; those with faults come last."""
        wanted = [(params, seed) for params in self.points.values() for seed in self.seeds]
        point_mass, rigid_body = (
            [EvaluationTask(first + number, params, (seed,)) for number, (params, seed) in enumerate(wanted)]
            for first in (0, len(wanted))
        )
        faulty = [
            (params, seed, variant)
            for variant in range(len(self.faults))
            for params in self.points.values()
            for seed in self.seeds[: self.fault_seeds]
        ]
        rigid_body += [
            EvaluationTask(2 * len(wanted) + number, params, (seed,), variant)
            for number, (params, seed, variant) in enumerate(faulty)
        ]
        return point_mass, rigid_body

    def check_flyable(self) -> None:
        """Build each flock once, so that what cannot be flown is refused before anything is written.

        Raises:
            MoflockError: one line that says why.
        """
        for job in self.jobs():
            for params in self.points.values():
                for scenario in (job.scenario, *job.variants):
                    Simulation(params, scenario, job.dynamics, self.seeds[0])

    def to_json(self) -> str:
        """All but the scenario, which is a file of its own."""
        content = {
            "policy": self.policy,
            "points": {name: values_of(params) for name, params in self.points.items()},
            "seeds": self.seeds,
            "fault_seeds": self.fault_seeds,
            "versions": dict(self.versions),
        }
        return json.dumps(content, indent=1) + "\n"

    @classmethod
    def from_texts(cls, configuration: str, scenario: str) -> ValidationConfig:
        """Read what `to_json` and the scenario's `to_toml` wrote.

        Raises:
            MoflockError: not such texts.
        """
        try:
            content = json.loads(configuration)
        except (ValueError, RecursionError) as problem:
            raise SearchError(f"configuration: not JSON: {problem}") from None
        if not isinstance(content, Mapping) or set(content) - {"fault_seeds", "policy"} != {
            "points",
            "seeds",
            "versions",
        }:
            raise SearchError("configuration: not a validation's: it must have points, seeds and versions")
        points, seeds = content["points"], content["seeds"]
        if not isinstance(points, Mapping) or not all(isinstance(params, Mapping) for params in points.values()):
            raise SearchError("configuration: points: it must be an object of points by name")
        if not isinstance(seeds, list) or not all(type(seed) is int and seed >= 0 for seed in seeds):
            raise SearchError("configuration: seeds: they must be whole numbers of at least 0")
        fault_seeds = content.get("fault_seeds", 0)
        if type(fault_seeds) is not int:
            raise SearchError("configuration: fault_seeds: it must be a whole number of at least 0")
        policy = find_policy(content.get("policy", DEFAULT_POLICY))
        return cls(
            scenario=Scenario.from_toml(scenario),
            fault_seeds=fault_seeds,
            points={str(name): _point_of(policy, params) for name, params in points.items()},
            seeds=tuple(seeds),
            versions=content["versions"],
        )


class ValidationDirectory(Archive):
    """A validation's directory, made by `create` or found by `open`.

    Attributes:
        settings: what is validated.
    """

    def __init__(self, path: Path, settings: ValidationConfig) -> None:
        super().__init__(path, POLICIES[settings.policy])
        self.settings = settings

    @classmethod
    def create(cls, path: Path, settings: ValidationConfig) -> ValidationDirectory:
        """Make a new directory.

        Raises:
            SearchError: there is something already, or it cannot be written.
        """
        write_directory(path, settings.scenario, settings.to_json())
        return cls(path, settings)

    @classmethod
    def open(cls, path: Path) -> ValidationDirectory:
        """Open a directory; what is damaged in its archive is left out.

        Raises:
            SearchError: it is none, or it cannot be read.
        """
        run = cls(path, read_directory(path, ValidationConfig.from_texts))
        run.count_damaged()
        return run


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Validation:
    """What the flights of a validation have shown; the first axis is that of DYNAMICS.

    Attributes:
        settings: what was validated.
        fitness: (2, P, S, 6).
        figures: (2, P, S, F), in the order of FIGURE_NAMES.
        failed: (2, P), flights that failed and count as fitness 0.
        faults: how each of the standard faults was borne; empty if none were flown.
    """

    settings: ValidationConfig
    fitness: NDArray[np.float64]
    figures: NDArray[np.float64]
    failed: NDArray[np.int64]
    faults: tuple[FaultTrial, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.settings.points)

    @functools.cached_property
    def objectives(self) -> NDArray[np.float64]:
        """(2, P, S, 2), F_1 and F_2 of each flight."""
        return PAPER.of_columns(self.fitness)

    @functools.cached_property
    def on_front(self) -> NDArray[np.bool_]:
        """(2, P), which points no other one dominates in the mean of F_1 and F_2."""
        return np.array([non_dominated(values.mean(axis=1)) for values in self.objectives])

    @functools.cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """(P,), of the rigid-body flights."""
        diameter = 2 * load_airframe(self.settings.scenario.airframe).radius
        flown = zip(self.figures[RIGID_BODY], self.failed[RIGID_BODY], strict=True)
        return tuple(
            judge(figure_columns(figures), int(failed), self.settings.scenario.verdict, diameter)
            for figures, failed in flown
        )

    def column(self, name: str, dynamics: int = RIGID_BODY) -> NDArray[np.float64]:
        """(P, S), one figure of all flights."""
        return np.asarray(self.figures[dynamics, :, :, FIGURE_NAMES.index(name)])

    def energy_per_metre(self) -> NDArray[np.float64]:
        """(P, S), J/m, of rigid bodies: what all rotors took over the way of all drones."""
        return self.column("energy") / np.maximum(self.column("way"), 1e-9)

    def worst_seed(self, point: int) -> int:
        """The seed whose rigid-body flight is worst: most drones lost, then most touched, then the least F_1 F_2."""
        product = self.objectives[RIGID_BODY, point].prod(axis=-1)
        keys = (product, -self.column("touched")[point], -self.column("lost")[point])
        return self.settings.seeds[int(np.lexsort(keys)[0])]


def make_settings(scenario: Scenario, asked: Sequence[str], seeds: int, fault_seeds: int = 0) -> ValidationConfig:
    """The settings of a new validation, with as many seeds as asked that no search has used; see `ValidationConfig`.

    Raises:
        MoflockError: see `ValidationConfig` and `read_points`.
    """
    points, used = read_points(asked)
    check_seeds(seeds)
    return ValidationConfig(scenario=scenario, points=points, seeds=fresh_seeds(seeds, used), fault_seeds=fault_seeds)


def check_seeds(count: int) -> None:
    """Refuse so few seeds that there is no confidence interval, and so many that nobody waits for them.

    Raises:
        SearchError: one line.
    """
    if not 2 <= count <= _MAX_SEEDS:
        raise SearchError(f"seeds: {count} is out of bounds: it must be at least 2 and at most {_MAX_SEEDS}")


def fly_missing(
    run: ValidationDirectory, executors: Sequence[Executor], progress: ProgressCallback, stop: Callable[[], bool]
) -> bool:
    """Fly what the archive does not have yet, point masses first; each flight is kept as it ends.

    Args:
        run: the directory, which is locked meanwhile.
        executors: of the settings' jobs, one each.
        progress: called after each flight.
        stop: asked after each flight.

    Returns:
        Whether all is flown.
    """
    with run.locked():
        run.repair()
        done = {evaluation.number for evaluation in run.evaluations()}
        plan = run.settings.tasks()
        total = sum(map(len, plan))
        for generation, (executor, tasks) in enumerate(zip(executors, plan, strict=True)):
            for evaluation in executor.evaluate([task for task in tasks if task.number not in done]):
                run.append(evaluation, generation)
                done.add(evaluation.number)
                progress(len(done), total)
                if stop():
                    return len(done) == total
    return True


def gather(run: ValidationDirectory) -> Validation:
    """What a finished validation has shown.

    Raises:
        SearchError: flights are missing.
    """
    settings = run.settings
    found: dict[int, Evaluation] = {evaluation.number: evaluation for evaluation in run.evaluations()}
    numbers = [task.number for tasks in settings.tasks() for task in tasks]
    missing = sum(number not in found for number in numbers)
    if missing:
        raise SearchError(f"run directory {run.path}: {missing} of {len(numbers)} flights are missing; resume it")
    shape = (len(DYNAMICS), len(settings.points), len(settings.seeds))
    ordered = [found[number] for number in numbers[: math.prod(shape)]]
    return Validation(
        settings=settings,
        fitness=np.array([evaluation.fitness[0] for evaluation in ordered]).reshape(*shape, -1),
        figures=np.array([evaluation.figures[0] for evaluation in ordered]).reshape(*shape, -1),
        failed=np.array([evaluation.outcome != OK for evaluation in ordered]).reshape(shape).sum(axis=2),
        faults=fault_trials(
            settings.faults,
            [found[number] for number in numbers[math.prod(shape) :]],
            points=len(settings.points),
            seeds=settings.fault_seeds,
        ),
    )


def log_worst(validation: Validation, folder: Path, progress: ProgressCallback) -> dict[str, Path]:
    """Fly the worst seed of each point on rigid bodies again, with a log; one that is there already is kept.

    Returns:
        The log of each point; none for a point whose flights failed.
    """
    logs: dict[str, Path] = {}
    for number, (name, params) in enumerate(validation.settings.points.items()):
        if not validation.failed[RIGID_BODY, number]:
            seed = validation.worst_seed(number)
            logs[name] = folder / f"{name}-seed{seed}.mcap"
            if not logs[name].exists():
                scenario = validation.settings.jobs()[RIGID_BODY].scenario
                fly(params, scenario=scenario, seed=seed, log=logs[name], keep_samples=False)
        progress(number + 1, len(validation.names))
    return logs


def _point_of(policy: PolicySpec, params: Mapping[str, float]) -> NamedTuple:
    try:
        return point_from_values(policy, params)
    except PointError as problem:
        raise SearchError(f"configuration: points: {problem}") from None
