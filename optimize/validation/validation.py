"""Validation of points: flights as point masses and as rigid bodies on the same seeds, in a resumable directory."""

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
"""Indices into the first axis of a validation's arrays."""

SEEDS = 20

FAULT_SEEDS = 5
"""Default number of flights of each point with each fault."""

_MAX_SEEDS = 10_000


@dataclasses.dataclass(frozen=True, kw_only=True)
class ValidationConfig:
    """Settings of a validation: all inputs on which its result depends.

    Attributes:
        scenario: scenario of the flights; if it sets no step, rigid bodies use their default, point masses SEARCH_STEP.
        points: points by name.
        seeds: (S,), the same for all points and both dynamics.
        fault_seeds: number of these seeds on which rigid bodies fly each standard fault; 0 for no faults.
        versions: versions of the libraries.

    Raises:
        SearchError: there are no points, the points have several policies, or a number of seeds is out of bounds.
    """

    scenario: Scenario
    points: Mapping[str, NamedTuple]
    seeds: tuple[int, ...]
    fault_seeds: int = 0
    versions: Mapping[str, str] = dataclasses.field(default_factory=installed_versions)

    def __post_init__(self) -> None:
        if not self.points:
            raise SearchError("points: there are none; it must be at least 1")
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
        """The scenario with each of the standard faults, by name; empty if `fault_seeds` is 0."""
        return standard_faults(self.jobs()[RIGID_BODY].scenario) if self.fault_seeds else {}

    def jobs(self) -> tuple[Job, Job]:
        """Jobs of the executors, in the order of DYNAMICS; the variants of the second are the faults."""
        point_mass, rigid_body = (
            Job(scenario=search_scenario(self.scenario, dynamics), dynamics=dynamics, policy=self.policy)
            for dynamics in DYNAMICS
        )
        variants = tuple(standard_faults(rigid_body.scenario).values()) if self.fault_seeds else ()
        return point_mass, dataclasses.replace(rigid_body, variants=variants)

    def tasks(self) -> tuple[list[EvaluationTask], list[EvaluationTask]]:
        """Tasks of one flight each, in the order of DYNAMICS, numbered consecutively; those with faults are last."""
        pairs = [(params, seed) for params in self.points.values() for seed in self.seeds]
        point_mass, rigid_body = (
            [EvaluationTask(first + number, params, (seed,)) for number, (params, seed) in enumerate(pairs)]
            for first in (0, len(pairs))
        )
        faulty = [
            (params, seed, variant)
            for variant in range(len(self.faults))
            for params in self.points.values()
            for seed in self.seeds[: self.fault_seeds]
        ]
        rigid_body += [
            EvaluationTask(2 * len(pairs) + number, params, (seed,), variant)
            for number, (params, seed, variant) in enumerate(faulty)
        ]
        return point_mass, rigid_body

    def check_flyable(self) -> None:
        """Build each simulation once, so that errors are found before a directory is written.

        Raises:
            MoflockError: a point cannot be flown.
        """
        for job in self.jobs():
            for params in self.points.values():
                for scenario in (job.scenario, *job.variants):
                    Simulation(params, scenario, job.dynamics, self.seeds[0])

    def to_json(self) -> str:
        """JSON text of all settings but the scenario, which is stored in a separate file."""
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
        """Read the texts that `to_json` and the scenario's `to_toml` wrote.

        Raises:
            MoflockError: the texts have another form.
        """
        try:
            content = json.loads(configuration)
        except (ValueError, RecursionError) as error:
            raise SearchError(f"configuration: not JSON: {error}") from None
        if not isinstance(content, Mapping) or set(content) - {"fault_seeds", "policy"} != {
            "points",
            "seeds",
            "versions",
        }:
            raise SearchError("configuration: not that of a validation: it must have points, seeds and versions")
        points, seeds = content["points"], content["seeds"]
        if not isinstance(points, Mapping) or not all(isinstance(params, Mapping) for params in points.values()):
            raise SearchError("configuration: points: it must be an object of points by name")
        if not isinstance(seeds, list) or not all(type(seed) is int and seed >= 0 for seed in seeds):
            raise SearchError("configuration: seeds: it must be a list of whole numbers of at least 0")
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
    """Directory of a validation, made by `create` or opened by `open`.

    Attributes:
        settings: settings of the validation.
    """

    def __init__(self, path: Path, settings: ValidationConfig) -> None:
        super().__init__(path, POLICIES[settings.policy])
        self.settings = settings

    @classmethod
    def create(cls, path: Path, settings: ValidationConfig) -> ValidationDirectory:
        """Create a directory.

        Raises:
            SearchError: the directory is not empty or cannot be written.
        """
        write_directory(path, settings.scenario, settings.to_json())
        return cls(path, settings)

    @classmethod
    def open(cls, path: Path) -> ValidationDirectory:
        """Open a directory; damaged rows of its archive are skipped.

        Raises:
            SearchError: the path is not a validation's directory, or it cannot be read.
        """
        run = cls(path, read_directory(path, ValidationConfig.from_texts))
        run.count_damaged()
        return run


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Validation:
    """Results of a validation; the first axis of the arrays is in the order of DYNAMICS.

    Attributes:
        settings: settings of the validation.
        fitness: (2, P, S, 6), in the order of FITNESS_NAMES.
        figures: (2, P, S, F), in the order of FIGURE_NAMES.
        failed: (2, P), number of failed flights, whose fitness counts as 0.
        faults: results under each of the standard faults; empty if none were flown.
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
        """(2, P), whether a point is not dominated in the mean of F_1 and F_2."""
        return np.array([non_dominated(values.mean(axis=1)) for values in self.objectives])

    @functools.cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """(P,), verdicts on the rigid-body flights."""
        diameter = 2 * load_airframe(self.settings.scenario.airframe).radius
        flown = zip(self.figures[RIGID_BODY], self.failed[RIGID_BODY], strict=True)
        return tuple(
            judge(figure_columns(figures), int(failed), self.settings.scenario.verdict, diameter)
            for figures, failed in flown
        )

    def column(self, name: str, dynamics: int = RIGID_BODY) -> NDArray[np.float64]:
        """(P, S), one of the figures, for each flight."""
        return np.asarray(self.figures[dynamics, :, :, FIGURE_NAMES.index(name)])

    def energy_per_metre(self) -> NDArray[np.float64]:
        """(P, S), J/m, energy of all rotors per metre of path of all drones, for rigid bodies."""
        return self.column("energy") / np.maximum(self.column("way"), 1e-9)

    def worst_seed(self, point: int) -> int:
        """Seed of the worst rigid-body flight: most drones lost, then most touched, then smallest product F_1 F_2."""
        product = self.objectives[RIGID_BODY, point].prod(axis=-1)
        keys = (product, -self.column("touched")[point], -self.column("lost")[point])
        return self.settings.seeds[int(np.lexsort(keys)[0])]


def make_settings(scenario: Scenario, sources: Sequence[str], seeds: int, fault_seeds: int = 0) -> ValidationConfig:
    """Settings of a new validation on fresh seeds, which the searches behind the points have not used.

    Raises:
        MoflockError: see `ValidationConfig` and `read_points`.
    """
    points, used = read_points(sources)
    check_seeds(seeds)
    return ValidationConfig(scenario=scenario, points=points, seeds=fresh_seeds(seeds, used), fault_seeds=fault_seeds)


def check_seeds(count: int) -> None:
    """Check the number of seeds; a confidence interval needs at least two.

    Raises:
        SearchError: the number is out of bounds.
    """
    if not 2 <= count <= _MAX_SEEDS:
        raise SearchError(f"seeds: {count} is out of bounds: it must be at least 2 and at most {_MAX_SEEDS}")


def fly_missing(
    run: ValidationDirectory, executors: Sequence[Executor], progress: ProgressCallback, stop: Callable[[], bool]
) -> bool:
    """Make the flights that the archive lacks, point masses first, and archive each one as it ends.

    Args:
        run: the directory; it is locked during the flights.
        executors: one executor for each job of the settings.
        progress: called after each flight.
        stop: called after each flight; the flights stop when it returns True.

    Returns:
        Whether all flights are made.
    """
    with run.locked():
        run.repair()
        done = {evaluation.number for evaluation in run.evaluations()}
        all_tasks = run.settings.tasks()
        total = sum(map(len, all_tasks))
        for generation, (executor, tasks) in enumerate(zip(executors, all_tasks, strict=True)):
            for evaluation in executor.evaluate([task for task in tasks if task.number not in done]):
                run.append(evaluation, generation)
                done.add(evaluation.number)
                progress(len(done), total)
                if stop():
                    return len(done) == total
    return True


def gather(run: ValidationDirectory) -> Validation:
    """Results of a finished validation.

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
    """Fly the worst seed of each point as rigid bodies again, with a log; an existing log is kept.

    Returns:
        The log of each point without failed flights.
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
    except PointError as error:
        raise SearchError(f"configuration: points: {error}") from None
