"""Findings of a finished search, from its run directory; flights that are still missing are made once and stored."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.policies.registry import DEFAULT_POLICY, values_of
from moflock_mj.errors import SearchError
from moflock_mj.files import new_file
from moflock_mj.flight import fly
from moflock_mj.parameters.points import load_point
from moflock_mj.simulation.results import Flight
from optimize.analysis.pca import PrincipalComponents, load_components, principal_components
from optimize.evaluation.archive import Entry
from optimize.evaluation.batch import ProgressCallback, fresh_seeds
from optimize.evaluation.interface import Executor
from optimize.evaluation.objectives import Objectives
from optimize.search.configuration import SINGLE_OBJECTIVE, Configuration
from optimize.search.estimates import CAUTION, estimates, hypervolume, non_dominated
from optimize.search.front import SEEDS, ReevaluatedFront, candidates, fly_front, load_front
from optimize.search.run_directory import RunDirectory

FRONT = "front.json"
LANDMARKS = "landmarks.json"
COMPONENTS = "pca.json"
"""Names of files in a run directory."""

_PAPER_POINTS = ("A", "B", "model_optimum")
_MAX_FRONTS = 10


class Volume(NamedTuple):
    """Growth of a search's hypervolume.

    Attributes:
        flights: (G,), number of flights after each generation with an estimate.
        volume: (G,), hypervolume of the estimates, less CAUTION standard errors, after that generation.
    """

    flights: NDArray[np.int64]
    volume: NDArray[np.float64]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Findings:
    """Content of a report.

    Attributes:
        name: name of the run directory.
        configuration: configuration of the search.
        evaluations: number of evaluations in the archive, and how many of them failed.
        front: the front, flown again on fresh seeds.
        landmarks: the paper's points and the best points of single-objective runs, flown on the same seeds.
        landmark_names: names of the landmarks.
        generations: {generation from 1: (n, K)}, estimated fronts after the last even generations.
        volumes: {name of a run: growth of its hypervolume}.
        components: principal components of the fitnesses of random points; None if they were not analysed.
        parameters: principal components of the parameters on the front; None for fewer than three points.
        statistics: flights, with samples, of the points that are best in the first and in the last objective.
    """

    name: str
    configuration: Configuration
    evaluations: tuple[int, int]
    front: ReevaluatedFront
    landmarks: ReevaluatedFront
    landmark_names: tuple[str, ...]
    generations: dict[int, NDArray[np.float64]]
    volumes: dict[str, Volume]
    components: PrincipalComponents | None
    parameters: PrincipalComponents | None
    statistics: tuple[Flight, Flight]


def flown_front(
    run: RunDirectory, executor: Executor, seeds: int | None = None, progress: ProgressCallback | None = None
) -> ReevaluatedFront:
    """Front of a run on fresh seeds: read from its directory, or flown and stored there.

    Args:
        run: directory of a finished search.
        executor: evaluator for the run's scenario.
        seeds: least number of seeds; a stored front with fewer is flown again. None: any number, or SEEDS if new.
        progress: called after each flight.

    Raises:
        SearchError: the run has no evaluations, or the stored front cannot be read.
    """
    path = run.path / FRONT
    if path.exists():
        front = load_front(path)
        if seeds is None or len(front.seeds) >= seeds:
            return front
    evaluations = run.evaluations()
    configuration = run.configuration
    used = {seed for evaluation in evaluations for seed in evaluation.seeds}
    settings = configuration.settings
    front = fly_front(
        candidates(evaluations, configuration.objectives, settings.population),
        executor,
        objectives=configuration.objectives,
        scenario=configuration.scenario,
        dynamics=settings.dynamics,
        policy=configuration.bounds.policy,
        seeds=fresh_seeds(SEEDS if seeds is None else seeds, used),
        origin={"algorithm": settings.algorithm, "search_seed": settings.seed, "search_flights": settings.budget},
        progress=progress,
    )
    _write(path, front)
    return front


def gather(
    run: RunDirectory,
    executor: Executor,
    *,
    compared: Collection[RunDirectory] = (),
    seeds: int | None = None,
    progress: ProgressCallback | None = None,
) -> Findings:
    """Gather the content of a report, and make the flights that are missing for it.

    Args:
        run: directory of a finished search.
        executor: evaluator for the run's scenario.
        compared: other runs in the same scenario; the best point of each single-objective run becomes a landmark.
        seeds: number of fresh seeds for each point, as in `flown_front`.
        progress: called after each flight.

    Raises:
        SearchError: a compared run has another scenario or other dynamics; or see `flown_front`.
    """
    configuration = run.configuration
    for other in compared:
        same = (other.configuration.scenario, other.configuration.settings.dynamics)
        if same != (configuration.scenario, configuration.settings.dynamics):
            raise SearchError(f"run directory {other.path}: it must have the scenario and the dynamics of {run.path}")
    front = flown_front(run, executor, seeds, progress)
    entries = list(run.entries())
    points = _paper_points(configuration) | best_singles((run, *compared))
    components = run.path / COMPONENTS
    return Findings(
        name=run.path.name,
        configuration=configuration,
        evaluations=(len(entries), sum(entry.evaluation.outcome != "ok" for entry in entries)),
        front=front,
        landmarks=_landmarks(run.path / LANDMARKS, points, front, executor, progress),
        landmark_names=tuple(points),
        generations=estimated_fronts(entries, configuration.objectives),
        volumes={_run_name(other): growth(other) for other in (run, *compared)},
        components=load_components(components) if components.exists() else None,
        parameters=_parameter_components(front, configuration),
        statistics=(_fly(front, front.best(0)), _fly(front, front.best(-1))),
    )


def best_singles(runs: Collection[RunDirectory]) -> dict[str, NamedTuple]:
    """Best point of each single-objective run, by the name of its algorithm."""
    found: dict[str, NamedTuple] = {}
    for run in runs:
        settings = run.configuration.settings
        if settings.algorithm in SINGLE_OBJECTIVE:
            best = candidates(run.evaluations(), run.configuration.maximised, 1)
            name = f"{settings.algorithm}, unbounded" if settings.unbounded else settings.algorithm
            if len(best):
                found[name] = run.configuration.bounds.params(best[0])
    return found


def estimated_fronts(entries: list[Entry], objectives: Objectives) -> dict[int, NDArray[np.float64]]:
    """Estimated front after each of the last ten even generations: {generation from 1: (n, K)}."""
    last = max((entry.generation for entry in entries), default=0) + 1
    numbers = list(range(2, last + 1, 2))[-_MAX_FRONTS:] or [last]
    return {generation: _estimated(entries, objectives, generation) for generation in numbers}


def growth(run: RunDirectory) -> Volume:
    """Growth of a run's hypervolume, generation by generation."""
    entries, objectives = list(run.entries()), run.configuration.objectives
    last = max((entry.generation for entry in entries), default=-1) + 1
    flights = np.zeros(last, np.int64)
    for entry in entries:
        flights[entry.generation] += len(entry.evaluation.seeds)
    # Before any point has flown twice, the noise is unknown, and the hypervolume would be overestimated.
    first = 2 if run.configuration.settings.noise == "refly" and last > 1 else 1
    volumes = [hypervolume(_estimated(entries, objectives, generation)) for generation in range(first, last + 1)]
    return Volume(np.cumsum(flights)[first - 1 :], np.array(volumes))


def _estimated(entries: list[Entry], objectives: Objectives, generations: int) -> NDArray[np.float64]:
    """Front (n, K) of the estimates, less CAUTION standard errors, after a number of generations."""
    evaluations = [entry.evaluation for entry in entries if entry.generation < generations]
    known = estimates(evaluations, objectives)
    values = np.array([np.maximum(estimate.mean - CAUTION * estimate.std_error, 0) for estimate in known])
    return values[non_dominated(values)]


def _paper_points(configuration: Configuration) -> dict[str, NamedTuple]:
    """Points of the paper; none for another policy than the paper's."""
    return {name: load_point(name) for name in _PAPER_POINTS} if configuration.bounds.policy == DEFAULT_POLICY else {}


def _landmarks(
    path: Path,
    points: dict[str, NamedTuple],
    front: ReevaluatedFront,
    executor: Executor,
    progress: ProgressCallback | None,
) -> ReevaluatedFront:
    """Points on the seeds of the front: read if the file holds these points and seeds, else flown and stored."""
    required = np.array([list(values_of(params).values()) for params in points.values()], np.float64)
    if path.exists():
        known = load_front(path)
        if known.seeds == front.seeds and np.array_equal(known.points, required):
            return known
    flown = fly_front(
        required,
        executor,
        objectives=front.objectives,
        scenario=front.scenario,
        dynamics=front.dynamics,
        policy=front.policy,
        seeds=front.seeds,
        progress=progress,
    )
    _write(path, flown)
    return flown


def _parameter_components(front: ReevaluatedFront, configuration: Configuration) -> PrincipalComponents | None:
    points = configuration.bounds.to_unit(front.points[front.remaining])
    return principal_components(points, configuration.bounds.spec.names) if len(points) > 2 else None


def _fly(front: ReevaluatedFront, number: int) -> Flight:
    return fly(front.params(number), scenario=front.scenario, dynamics=front.dynamics, seed=front.seeds[0])


def _run_name(run: RunDirectory) -> str:
    settings = run.configuration.settings
    return f"{settings.algorithm}, seed {settings.seed}" + (", unbounded" if settings.unbounded else "")


def _write(path: Path, front: ReevaluatedFront) -> None:
    with new_file(path) as place:
        place.write_text(front.to_json(), encoding="utf-8")
