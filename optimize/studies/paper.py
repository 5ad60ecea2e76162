"""Reproduction of the paper's study: `make paper`, or `python -m optimize.studies.paper`.

The study writes `docs/reproduction.md` with its figures, and the project's named points. Searches and fronts are stored
in `logs/paper/` and are not flown again; remove that folder to repeat them.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any, NamedTuple

from moflock_mj.analysis.target_tracking import TargetResult, track_target
from moflock_mj.files import new_file
from moflock_mj.flight import fly
from moflock_mj.parameters.points import load_point
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.visualization.flight_figure import save_flight_figure
from optimize.analysis.pca import Agreement, agreement, components_json, grouped_by_sign, study
from optimize.cli.console import flights_progress
from optimize.evaluation.batch import evaluate_batch, fresh_seeds
from optimize.evaluation.evaluation import Job, search_scenario
from optimize.evaluation.executors import make_executor
from optimize.evaluation.interface import Executor
from optimize.evaluation.objectives import PAPER
from optimize.reports.figures import save
from optimize.reports.flight_figures import target_figure
from optimize.reports.search_report import write_report
from optimize.search.configuration import Configuration, SearchConfig
from optimize.search.findings import COMPONENTS, Findings, best_singles, flown_front, gather
from optimize.search.front import SEEDS, ReevaluatedFront, point_json
from optimize.search.run_directory import RunDirectory
from optimize.search.search import search
from optimize.studies import comparison
from optimize.studies.comparison import score
from optimize.studies.paper_page import Single, Study, named_points, render_paper_page

NAMED_POINTS = Path(__file__).parents[2] / "moflock_mj" / "parameters" / "named_points"
"""Folder of the project's named points, which `moflock_mj.parameters.points` reads."""


class Effort(NamedTuple):
    """Numbers of points, runs and flights of the study.

    Attributes:
        points: number of random points of each principal component analysis.
        analyses: number of principal component analyses, each on its own seed.
        budget: flights of each search.
        runs: number of runs of each compared search.
        fresh: number of fresh seeds on which the searches are compared.
        seeds: number of fresh seeds for each point of the front.
        tracks: number of target-tracking flights of each point.
    """

    points: int = 500
    analyses: int = 4
    budget: int = 2000
    runs: int = 3
    fresh: int = comparison.SEEDS
    seeds: int = SEEDS
    tracks: int = 30


def reproduce(scenario: Scenario, logs: Path, docs: Path, named: Path, *, workers: int, effort: Effort) -> Path:
    """Run the whole study.

    Args:
        scenario: scenario of the flights, which are point-mass flights.
        logs: folder of the searches; existing ones are resumed.
        docs: output folder for `reproduction.md` and its figures.
        named: output folder for the named points.
        workers: number of processes.
        effort: numbers of points, runs and flights.

    Returns:
        Path of the page.

    Raises:
        MoflockError: a flight fails or a file cannot be written.
    """
    scenario = search_scenario(scenario, "point_mass")
    pictures = docs / "reproduction"
    runs = {
        name: [_searched(logs, scenario, workers, effort, seed=seed, **chosen) for seed in range(1, effort.runs + 1)]
        for name, chosen in comparison.COMPETITORS.items()
    }
    main, single = runs["NSGA-II"][0], runs["CMA-ES"][0]
    analyses = _analyses(main, scenario, workers, effort)
    tracked = {name: _tracked(name, scenario, effort.tracks) for name in ("A", "B")}
    with make_executor(Job(scenario=scenario, dynamics="point_mass"), workers) as executor:
        found = _findings(main, single, executor, effort.seeds)
        scores = {
            name: score([_front(path, executor, effort.fresh) for path in paths], effort.fresh)
            for name, paths in runs.items()
        }
    singles = _singles(single, logs, scenario, workers, effort)
    results = Study(found, analyses, scores, effort.budget, effort.fresh, singles, tracked)
    write_report(found, pictures)
    _draw_flight(singles["without bounds"], scenario, pictures / "unbounded.png")
    save(lambda: target_figure([tracked["A"][0], tracked["B"][0]], ["Point A", "Point B"]), pictures / "target.png")
    for name, (number, rule) in named_points(found.front).items():
        with new_file(named / f"{name}.json") as place:
            place.write_text(point_json(found.front, number, rule=rule), encoding="utf-8")
    page_path = docs / "reproduction.md"
    with new_file(page_path) as place:
        place.write_text(render_paper_page(results), encoding="utf-8")
    return page_path


def _searched(
    logs: Path, scenario: Scenario, workers: int, effort: Effort, *, coverage: bool = False, **chosen: Any
) -> Path:
    """Run a search, or resume it, and return its directory."""
    settings = SearchConfig(budget=effort.budget, **chosen)
    configuration = Configuration(
        scenario=scenario, objectives=PAPER.with_coverage() if coverage else PAPER, settings=settings
    )
    parts = [settings.algorithm, settings.noise, "unbounded" * settings.unbounded, "coverage" * coverage]
    path = logs / "-".join([*filter(None, parts), str(settings.seed)])
    known = (path / "configuration.json").exists()
    with (
        RunDirectory.open(path) if known else RunDirectory.create(path, configuration) as run,
        make_executor(run.configuration.job, workers) as executor,
        flights_progress(path.name) as progress,
    ):
        search(run, executor, lambda state: progress(state.flights, state.budget))
    return path


def _findings(main: Path, single: Path, executor: Executor, seeds: int) -> Findings:
    with (
        RunDirectory.open(main) as run,
        RunDirectory.open(single) as other,
        flights_progress("front") as progress,
    ):
        return gather(run, executor, compared=[other], seeds=seeds, progress=progress)


def _front(path: Path, executor: Executor, seeds: int) -> ReevaluatedFront:
    with RunDirectory.open(path) as run, flights_progress(f"front of {path.name}") as progress:
        return flown_front(run, executor, seeds, progress)


def _singles(bounded: Path, logs: Path, scenario: Scenario, workers: int, effort: Effort) -> dict[str, Single]:
    """Best points of CMA-ES with and without bounds, flown on fresh seeds with coverage."""
    runs = {"within bounds": bounded}
    for name, coverage in (("without bounds", False), ("without bounds, with coverage", True)):
        runs[name] = _searched(
            logs, scenario, workers, effort, coverage=coverage, algorithm="cmaes", unbounded=True, seed=1
        )
    found = {}
    with make_executor(Job(scenario=scenario, dynamics="point_mass", coverage=True), workers) as executor:
        for name, path in runs.items():
            with RunDirectory.open(path) as run, flights_progress(f"CMA-ES {name}") as progress:
                (params,) = best_singles([run]).values()
                used = {seed for evaluation in run.evaluations() for seed in evaluation.seeds}
            seeds = fresh_seeds(effort.fresh, used)
            flown = evaluate_batch(executor, [params], [seeds], progress)
            found[name] = Single(params, flown.fitness[0], seeds[0])
    return found


def _draw_flight(single: Single, scenario: Scenario, out: Path) -> None:
    flight = fly(single.params, scenario=scenario, dynamics="point_mass", seed=single.seed)
    with new_file(out) as place:
        save_flight_figure(flight, place)


def _analyses(run: Path, scenario: Scenario, workers: int, effort: Effort) -> list[Agreement]:
    """Principal components on several seeds, with MOflock's initial state; those of the first seed are stored."""
    found = []
    start = scenario.replace(start="moflock")
    configuration = Configuration(scenario=start)
    with make_executor(Job(scenario=start, dynamics="point_mass"), workers) as executor:
        for seed in range(1, effort.analyses + 1):
            with flights_progress(f"random points, seed {seed}") as progress:
                components, _ = study(
                    executor, configuration.bounds, points=effort.points, seed=seed, progress=progress
                )
            found.append(agreement(components))
            if seed == 1:
                with new_file(run / COMPONENTS) as place:
                    objectives = grouped_by_sign(components, start)
                    place.write_text(components_json(components, objectives), encoding="utf-8")
    return found


def _tracked(name: str, scenario: Scenario, flights: int) -> list[TargetResult]:
    """Flights of a point around a target in a corner of the arena, the paper's extreme case."""
    corner = scenario.arena.extent()
    return [
        track_target(load_point(name), target=corner, scenario=scenario, seed=seed) for seed in range(1, flights + 1)
    ]


def main() -> None:
    """Read the arguments and run the study."""
    parser = argparse.ArgumentParser(description="Reproduce the paper's study and write docs/reproduction.md.")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--logs", type=Path, default=Path("logs/paper"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--named", type=Path, default=NAMED_POINTS)
    arguments = parser.parse_args()
    print(
        reproduce(
            Scenario(), arguments.logs, arguments.docs, arguments.named, workers=arguments.workers, effort=Effort()
        )
    )


if __name__ == "__main__":
    main()
