"""The front on physics: `python -m optimize.studies.physics`, which is `make physics`.

Searches rigid bodies with and without screening on point masses, and screened from a front that was found on point
masses, with as many flights of bodies; flies what each found on fresh seeds beside that front. Then it validates the
most promising of all points that flew safely so far, and names the best of those that still do. Writes
`docs/physics.md`, its figure and the named point. What was flown once stays in `logs/physics/` and is not flown again;
remove that folder to begin anew.
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
    """How much is flown.

    Attributes:
        flights: of bodies, in each search.
        runs: searches of each kind.
        points: most points of each front that are flown again.
        seeds: fresh ones for each of these.
        population: points per generation.
        judged: points that are validated.
        trials: fresh seeds for each of these.
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
    """Search on bodies, fly all fronts on the same fresh seeds, compare them, and name a point that is flyable.

    Args:
        scenario: what is flown; without a point mass of its own it gets that of its airframe.
        point_mass: a search on point masses whose front was flown: its directory, or its front's file.
        logs: where the searches go, and are taken up again.
        docs: gets `physics.md` and a folder with its figure.
        named: gets the named point.
        effort: how much is flown.
        workers: processes.

    Returns:
        The page.

    Raises:
        MoflockError: something cannot be read, flown or written.
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
    trials = fresh_seeds(effort.trials, used | set(seeds))
    judged = validate_points(logs / "judged", points, scenario, trials, workers, TERMINAL)
    best = best_flyable(judged)
    if best is not None:
        with new_file(named / f"{NAMED}.json") as place:
            place.write_text(provenance(judged, best), encoding="utf-8")
    with new_file(docs / "physics.md") as place:
        flights = Flights(effort.flights, _screening_flights(runs[SCREENED]), screening.point_mass)
        place.write_text(render_physics_page(fronts, flights, judged, best), encoding="utf-8")
    save(lambda: fronts_figure(fronts, judged), docs / "physics" / "fronts.png")
    return docs / "physics.md"


def _seeds_of(path: Path) -> set[int]:
    """The seeds that a search has flown."""
    with RunDirectory.open(path) as run:
        return {seed for evaluation in run.evaluations() for seed in evaluation.seeds}


def _calibrated(scenario: Scenario, logs: Path) -> Scenario:
    """The scenario with its point mass, identified once."""
    kept = logs / "scenario.toml"
    if not kept.exists():
        found = calibrated(scenario)
        with new_file(kept) as place:
            place.write_text(found.to_toml(), encoding="utf-8")
        return found
    known = Scenario.load(kept)
    if known.replace(point_mass=scenario.point_mass) != scenario:
        raise SearchError(f"run directory {logs}: it is of another scenario; remove it")
    return known


def _searched(
    logs: Path, scenario: Scenario, effort: Effort, seed: int, workers: int, kind: str, start: NDArray[np.float64]
) -> Path:
    """The directory of a search on bodies that is over; a search that was broken off goes on."""
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
    """A search's candidates on bodies; the front stays in its directory, where other commands look for it."""
    with RunDirectory.open(path) as run:
        points = candidates(run.evaluations(), PAPER, most)
    return _flown(path / FRONT, points, executor, scenario, seeds)


def _flown(
    path: Path, points: NDArray[np.float64], executor: Executor, scenario: Scenario, seeds: Sequence[int]
) -> ReevaluatedFront:
    """Points on bodies: read, if the file has just these on these seeds, else flown and written."""
    if path.exists():
        known = load_front(path)
        if known.seeds == tuple(seeds) and np.array_equal(known.points, points):
            return known
    with flights_progress(f"bodies: {path.parent.name}/{path.name}") as progress:
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
    """The points of a front that remain, at most `most`, spread evenly along it, its ends and its knee among them."""
    kept = front.remaining
    if len(kept) > most:
        chosen = np.linspace(0, len(kept) - 1, most).round().astype(int)
        knee = int(np.flatnonzero(kept == front.knee)[0])
        chosen[int(np.argmin(np.abs(chosen - knee)))] = knee
        kept = kept[chosen]
    return front.points[kept]


def _screening_flights(paths: Sequence[Path]) -> int:
    """Flights on point masses of all screened searches, on average."""
    flights = 0
    for path in paths:
        with RunDirectory.open(path) as run:
            flights += sum(len(flown.seeds) for flown in run.screening.evaluations()) if run.screening else 0
    return round(flights / len(paths))


def main() -> None:
    """Read the arguments and do the study."""
    parser = argparse.ArgumentParser(description="Search on physics in three ways: docs/physics.md.")
    parser.add_argument("--point-mass", type=Path, default=Path("logs/paper/nsga2-refly-1"))
    parser.add_argument("--logs", type=Path, default=Path("logs/physics"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--named", type=Path, default=NAMED_POINTS)
    parser.add_argument("--duration", type=float, default=Scenario().duration)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    for name, value in Effort()._asdict().items():
        parser.add_argument(f"--{name}", type=int, default=value)
    asked = parser.parse_args()
    effort = Effort(**{name: getattr(asked, name) for name in Effort._fields})
    scenario = Scenario(duration=asked.duration)
    places = (asked.point_mass, asked.logs, asked.docs, asked.named)
    print(make_study(scenario, *places, effort=effort, workers=asked.workers))


if __name__ == "__main__":
    main()
