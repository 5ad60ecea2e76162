"""Study of searches on rigid bodies: `make physics`, or `python -m optimize.studies.physics`.

The study searches rigid bodies in three ways with equal numbers of rigid-body flights: without screening, with
screening on point masses, and with screening from a front found on point masses. It flies all resulting fronts, and the
front from point masses, as rigid bodies on the same fresh seeds. It then validates the most promising points that were
safe so far, and names the best one that is still safe. It writes `docs/physics.md`, its figure and the named point. All
flights are stored in `logs/physics/` and are not repeated; remove that folder to repeat them.
"""

from __future__ import annotations

import argparse
import contextlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.policies.registry import DEFAULT_POLICY, POLICIES, make_params
from moflock_mj.analysis.identification import calibrated
from moflock_mj.errors import SearchError
from moflock_mj.files import new_file
from moflock_mj.scenario.scenario import Scenario
from optimize.cli.console import TERMINAL, flights_progress, search_progress
from optimize.evaluation.batch import fresh_seeds
from optimize.evaluation.evaluation import Job
from optimize.evaluation.executors import make_executor
from optimize.evaluation.interface import Executor
from optimize.evaluation.objectives import PAPER
from optimize.reports.figures import save
from optimize.search.configuration import Configuration, SearchConfig
from optimize.search.findings import FRONT
from optimize.search.front import ReevaluatedFront, candidates, fly_front, load_front
from optimize.search.run_directory import RunDirectory
from optimize.search.search import open_executors, search
from optimize.studies.paper import NAMED_POINTS
from optimize.studies.physics_page import (
    KINDS,
    PLAIN,
    REFINED,
    SCREENED,
    Flights,
    Fronts,
    fronts_figure,
    render_physics_page,
)
from optimize.validation.flyable import NAMED, best_flyable, promising_points, provenance, validate_points


class Effort(NamedTuple):
    """Numbers of runs, points and flights of the study.

    Attributes:
        flights: rigid-body flights of each search.
        runs: number of searches of each kind.
        points: largest number of points of each front that are flown again.
        seeds: number of fresh seeds for each of these points.
        population: points per generation.
        judged: largest number of points that are validated.
        trials: number of fresh seeds for each validated point.
    """

    flights: int = 500
    runs: int = 2
    points: int = 12
    seeds: int = 20
    population: int = 30
    judged: int = 40
    trials: int = 20


def make_study(
    scenario: Scenario, point_mass: Path, logs: Path, docs: Path, named: Path, *, effort: Effort, workers: int
) -> Path:
    """Search on rigid bodies, compare all fronts on the same fresh seeds, and name a flyable point.

    Args:
        scenario: scenario of the flights; if it sets no point mass, that of its airframe is identified.
        point_mass: directory of a search on point masses with a re-evaluated front, or the file of the front.
        logs: folder of the searches; existing ones are resumed.
        docs: output folder for `physics.md` and its figure.
        named: output folder for the named point.
        effort: numbers of runs, points and flights.
        workers: number of processes.

    Returns:
        Path of the page.

    Raises:
        MoflockError: a flight fails, or a file cannot be read or written.
    """
    found_there = load_front(point_mass / FRONT if point_mass.is_dir() else point_mass)
    screening = _calibrated(scenario, logs)
    assert screening.point_mass is not None  # for the type checker
    start = _thinned(found_there, effort.points)
    runs = {
        kind: [_searched(logs, screening, effort, seed, workers, kind, start) for seed in range(1, effort.runs + 1)]
        for kind in KINDS
    }
    paths = [path for some in runs.values() for path in some]
    used = set(found_there.seeds).union(*map(_seeds_of, paths))
    seeds = fresh_seeds(effort.seeds, used)
    with make_executor(Job(scenario=scenario, dynamics="rigid_body"), workers) as executor:
        there = _flown(logs / "point-mass-front.json", start, executor, scenario, seeds)
        searched = {
            kind: tuple(_front_of(path, executor, scenario, seeds, effort.points) for path in some)
            for kind, some in runs.items()
        }
    fronts = Fronts(found_there=found_there, point_mass=there, searched=searched)
    points = promising_points(paths, scenario, effort.judged)
    validation_seeds = fresh_seeds(effort.trials, used | set(seeds))
    validated = validate_points(logs / "judged", points, scenario, validation_seeds, workers, TERMINAL)
    best = best_flyable(validated)
    if best is not None:
        with new_file(named / f"{NAMED}.json") as place:
            place.write_text(provenance(validated, best), encoding="utf-8")
    with new_file(docs / "physics.md") as place:
        flights = Flights(effort.flights, _screening_flights(runs[SCREENED]), screening.point_mass)
        place.write_text(render_physics_page(fronts, flights, validated, best), encoding="utf-8")
    save(lambda: fronts_figure(fronts, validated), docs / "physics" / "fronts.png")
    return docs / "physics.md"


def _seeds_of(path: Path) -> set[int]:
    """Seeds that a search has used."""
    with RunDirectory.open(path) as run:
        return {seed for evaluation in run.evaluations() for seed in evaluation.seeds}


def _calibrated(scenario: Scenario, logs: Path) -> Scenario:
    """Scenario with the identified point mass, which is stored for later runs."""
    path = logs / "scenario.toml"
    if not path.exists():
        found = calibrated(scenario)
        with new_file(path) as place:
            place.write_text(found.to_toml(), encoding="utf-8")
        return found
    known = Scenario.load(path)
    if known.replace(point_mass=scenario.point_mass) != scenario:
        raise SearchError(f"run directory {logs}: it is of another scenario; remove it")
    return known


def _searched(
    logs: Path, scenario: Scenario, effort: Effort, seed: int, workers: int, kind: str, start: NDArray[np.float64]
) -> Path:
    """Run a search on rigid bodies, or resume it, and return its directory."""
    path = logs / f"{kind}-{seed}"
    settings = SearchConfig(
        dynamics="rigid_body", screen=kind != PLAIN, seed=seed, budget=effort.flights, population=effort.population
    )
    first = tuple(make_params(POLICIES[DEFAULT_POLICY], point) for point in start.tolist()) if kind == REFINED else ()
    configuration = Configuration(scenario=scenario, settings=settings, start=first)
    with contextlib.ExitStack() as resources:
        known = (path / "configuration.json").exists()
        run = resources.enter_context(RunDirectory.open(path) if known else RunDirectory.create(path, configuration))
        if (run.configuration.settings, run.configuration.start) != (settings, first):
            raise SearchError(f"run directory {path}: it is of another search; remove it")
        executor, screening = open_executors(run.configuration, workers, None, resources)
        progress = resources.enter_context(search_progress(run.configuration))
        search(run, executor, progress, screening=screening)
    return path


def _front_of(path: Path, executor: Executor, scenario: Scenario, seeds: Sequence[int], most: int) -> ReevaluatedFront:
    """Front of a search on rigid bodies, stored in its directory, where other commands read it."""
    with RunDirectory.open(path) as run:
        points = candidates(run.evaluations(), PAPER, most)
    return _flown(path / FRONT, points, executor, scenario, seeds)


def _flown(
    path: Path, points: NDArray[np.float64], executor: Executor, scenario: Scenario, seeds: Sequence[int]
) -> ReevaluatedFront:
    """Front of points as rigid bodies: read if the file holds these points and seeds, else flown and stored."""
    if path.exists():
        known = load_front(path)
        if known.seeds == tuple(seeds) and np.array_equal(known.points, points):
            return known
    with flights_progress(f"rigid bodies: {path.parent.name}/{path.name}") as progress:
        front = fly_front(
            points,
            executor,
            objectives=PAPER,
            scenario=scenario,
            dynamics="rigid_body",
            policy=DEFAULT_POLICY,
            seeds=seeds,
            progress=progress,
        )
    with new_file(path) as place:
        place.write_text(front.to_json(), encoding="utf-8")
    return front


def _thinned(front: ReevaluatedFront, most: int) -> NDArray[np.float64]:
    """At most `most` points of a front, evenly spread, with its ends and its knee."""
    kept = front.remaining
    if len(kept) > most:
        chosen = np.linspace(0, len(kept) - 1, most).round().astype(int)
        knee = int(np.flatnonzero(kept == front.knee)[0])
        chosen[int(np.argmin(np.abs(chosen - knee)))] = knee
        kept = kept[chosen]
    return front.points[kept]


def _screening_flights(paths: Sequence[Path]) -> int:
    """Mean number of point-mass flights of the screened searches."""
    flights = 0
    for path in paths:
        with RunDirectory.open(path) as run:
            flights += sum(len(evaluation.seeds) for evaluation in run.screening.evaluations()) if run.screening else 0
    return round(flights / len(paths))


def main() -> None:
    """Read the arguments and run the study."""
    parser = argparse.ArgumentParser(description="Search on rigid bodies in three ways and write docs/physics.md.")
    parser.add_argument("--point-mass", type=Path, default=Path("logs/paper/nsga2-refly-1"))
    parser.add_argument("--logs", type=Path, default=Path("logs/physics"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--named", type=Path, default=NAMED_POINTS)
    parser.add_argument("--duration", type=float, default=Scenario().duration)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    for name, value in Effort()._asdict().items():
        parser.add_argument(f"--{name}", type=int, default=value)
    arguments = parser.parse_args()
    effort = Effort(**{name: getattr(arguments, name) for name in Effort._fields})
    scenario = Scenario(duration=arguments.duration)
    places = (arguments.point_mass, arguments.logs, arguments.docs, arguments.named)
    print(make_study(scenario, *places, effort=effort, workers=arguments.workers))


if __name__ == "__main__":
    main()
