"""The paper's study from its beginning to its figures: `python -m optimize.paper`, which is `make paper`.

Writes `docs/reproduction.md` with the figures beside it, and the project's own named points. What was flown once stays
in `logs/paper/` and is not flown again; remove that folder to begin anew.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from moflock_mj.new_file import new_file
from moflock_mj.points import paper_point
from moflock_mj.scenario import Scenario
from moflock_mj.target import TargetResult, track_target
from optimize.archive import RunDirectory
from optimize.configuration import Configuration, Settings, search_scenario
from optimize.evaluation import Job
from optimize.executor import make_executor
from optimize.figures import save
from optimize.findings import COMPONENTS, Findings, gather
from optimize.flight_figures import target_figure
from optimize.front import SEEDS, FlownFront, best_with, point_json
from optimize.objectives import FITNESS_NAMES
from optimize.pca import Agreement, agreement, components_json, grouped_by_sign, study
from optimize.reference import COVARIANCE, FIRST_COMPONENT, PAPER_RESULTS
from optimize.report import write_report
from optimize.search import search
from optimize.verbs import flights_progress

NAMED_POINTS = Path(__file__).parent.parent / "moflock_mj" / "named_points"
"""Where `moflock_mj.points` finds the project's own points."""

CORNER = (250.0, 250.0)
"""m; the paper's extreme case is a target in a corner of the arena."""

_LEAST = 0.7
"""What `fast` keeps of the last objective and `cohesive` of the first: a flock that gives one up is no use."""


class Effort(NamedTuple):
    """How much is flown.

    Attributes:
        points: random points of each principal component analysis.
        analyses: how many of them, on seeds of their own.
        budget: flights of each search.
        seeds: fresh seeds for each point of the front.
        tracks: flights of each point around the target.
    """

    points: int = 500
    analyses: int = 4
    budget: int = 2000
    seeds: int = SEEDS
    tracks: int = 30


def reproduce(logs: Path, docs: Path, named: Path, *, workers: int, effort: Effort) -> Path:
    """Do the whole study.

    Args:
        logs: where the searches go, and are taken up again.
        docs: gets `reproduction.md` and a folder of figures.
        named: gets the named points.
        workers: processes.
        effort: how much is flown.

    Returns:
        The page.

    Raises:
        MoflockError: something cannot be written.
    """
    scenario = search_scenario(Scenario(), "point_mass")
    runs = [_searched(logs / name, name, scenario, workers, effort) for name in ("nsga2", "cmaes")]
    analyses = _analyses(runs[0], scenario, workers, effort)
    tracked = {name: _tracked(name, scenario, effort.tracks) for name in ("A", "B")}
    with (
        RunDirectory.open(runs[0]) as run,
        RunDirectory.open(runs[1]) as single,
        make_executor(run.configuration.job, workers) as executor,
        flights_progress("front") as told,
    ):
        found = gather(run, executor, compared=[single], seeds=effort.seeds, told=told)
    pictures = docs / "reproduction"
    write_report(found, pictures)
    save(lambda: target_figure([tracked["A"][0], tracked["B"][0]], ["Point A", "Point B"]), pictures / "target.png")
    for name, (number, rule) in named_points(found.front).items():
        with new_file(named / f"{name}.json") as place:
            place.write_text(point_json(found.front, number, rule=rule), encoding="utf-8")
    page = docs / "reproduction.md"
    with new_file(page) as place:
        place.write_text(_page(found, analyses, tracked), encoding="utf-8")
    return page


def named_points(front: FlownFront) -> dict[str, tuple[int, str]]:
    """Of each named point its number on the front and the rule by which it is chosen."""
    first, last = front.objectives.names[0], front.objectives.names[-1]
    return {
        "fast": (
            best_with(front, 0, kept=1, least=_LEAST),
            f"best mean {first} with a mean {last} of {_LEAST} or more",
        ),
        "knee": (front.knee, "knee of the front"),
        "cohesive": (
            best_with(front, 1, kept=0, least=_LEAST),
            f"best mean {last} with a mean {first} of {_LEAST} or more",
        ),
    }


def _searched(path: Path, algorithm: str, scenario: Scenario, workers: int, effort: Effort) -> Path:
    """The directory of a search that is over; a search that was broken off goes on."""
    configuration = Configuration(scenario=scenario, settings=Settings(algorithm=algorithm, budget=effort.budget))
    known = (path / "configuration.json").exists()
    with (
        RunDirectory.open(path) if known else RunDirectory.create(path, configuration) as run,
        make_executor(run.configuration.job, workers) as executor,
        flights_progress(algorithm) as told,
    ):
        search(run, executor, lambda progress: told(progress.flights, progress.budget))
    return path


def _analyses(run: Path, scenario: Scenario, workers: int, effort: Effort) -> list[Agreement]:
    """Principal components on several seeds, from the start that the paper's simulator has; the first is kept."""
    found = []
    start = scenario.replace(start="moflock")
    configuration = Configuration(scenario=start)
    with make_executor(Job(scenario=start, dynamics="point_mass"), workers) as executor:
        for seed in range(1, effort.analyses + 1):
            with flights_progress(f"random points, seed {seed}") as told:
                components, _ = study(executor, configuration.bounds, points=effort.points, seed=seed, told=told)
            found.append(agreement(components))
            if seed == 1:
                with new_file(run / COMPONENTS) as place:
                    objectives = grouped_by_sign(components, start)
                    place.write_text(components_json(components, objectives), encoding="utf-8")
    return found


def _tracked(name: str, scenario: Scenario, flights: int) -> list[TargetResult]:
    """A paper's point around a target in the corner, flight by flight."""
    return [
        track_target(paper_point(name), target=CORNER, scenario=scenario, seed=seed) for seed in range(1, flights + 1)
    ]


def _page(found: Findings, analyses: Sequence[Agreement], tracked: dict[str, list[TargetResult]]) -> str:
    """The page, in Markdown."""
    return "\n\n".join(
        [
            "# The paper's study, flown here",
            "Written by `make paper`; every number below is from that run. The whole report, with all figures, is "
            "[reproduction/index.html](reproduction/index.html).",
            _components_section(found, analyses),
            _front_section(found),
            _target_section(tracked),
        ]
    )


def _components_section(found: Findings, analyses: Sequence[Agreement]) -> str:
    components = found.components
    assert components is not None  # for the type checker: `reproduce` has just written them
    rows = [
        (f"F_{name}", f"{ours:.3f}", f"{theirs:.3f}")
        for name, ours, theirs in zip(FITNESS_NAMES, components.components[0], FIRST_COMPONENT, strict=True)
    ]
    matrix = [
        (f"F_{name}", *(f"{ours:.2f} ({theirs:.2f})" for ours, theirs in zip(mine, papers, strict=True)))
        for name, mine, papers in zip(FITNESS_NAMES, components.covariance, COVARIANCE, strict=True)
    ]
    seeds = [
        (str(seed), f"{near.cosine:.3f}", "yes" if near.same_signs else "no", f"{near.covariance_error:.3f}")
        for seed, near in enumerate(analyses, start=1)
    ]
    return "\n\n".join(
        [
            "## Principal components",
            f"{components.samples} random points, from MOflock's start. First component:",
            _markdown(("", "ours", "paper"), rows),
            "Covariance, ours (the paper's):",
            _markdown(("", *(f"F_{name}" for name in FITNESS_NAMES)), matrix),
            "On several seeds:",
            _markdown(("seed", "cosine", "same signs", "mean difference of covariance"), seeds),
            "The elements of F_coll differ most: the paper's collisions are tied closer to correlation and connection.",
            "![Principal components](reproduction/pca.png)",
        ]
    )


def _front_section(found: Findings) -> str:
    front, marks = found.front, found.landmarks
    rows: list[tuple[str, ...]] = [
        (f"{name}, the paper's table", f"{r.F_1[0]:.3f} ± {r.F_1[1]:.3f}", f"{r.F_2[0]:.3f} ± {r.F_2[1]:.3f}")
        for name, r in PAPER_RESULTS.items()
    ]
    rows += [(f"{name}, flown here", *_cells(marks, number)) for number, name in enumerate(found.landmark_names)]
    rows += [(f"our `{name}`: {rule}", *_cells(front, number)) for name, (number, rule) in named_points(front).items()]
    rows += [("our best F_1", *_cells(front, front.best(0))), ("our best F_2", *_cells(front, front.best(-1)))]
    return "\n\n".join(
        [
            "## Front",
            f"{found.evaluations[0]} evaluations; the front on {len(front.seeds)} fresh seeds has a hypervolume of "
            f"{front.hypervolume:.3f}, and {len(front.remaining)} points. Mean ± standard deviation from flight to "
            "flight:",
            _markdown(("point", *front.objectives.names), rows),
            "Flights here start apart and at rest. MOflock's drones start with one common velocity, which lends "
            "correlation and connection (F_2) to points that hardly align by themselves, such as A.",
            "![Front](reproduction/front.png)",
            "![Last even fronts](reproduction/generations.png)",
            "![Order parameters](reproduction/order_parameters.png)",
        ]
    )


def _target_section(tracked: dict[str, list[TargetResult]]) -> str:
    def median(values: Sequence[float]) -> str:
        return f"{float(np.median(values)):.4g}"

    rows = [
        (
            name,
            median([result.sine.amplitude for result in results]),
            median([result.sine.omega for result in results]),
            median([result.F_target for result in results]),
        )
        for name, results in tracked.items()
    ]
    return "\n\n".join(
        [
            "## Target in a corner",
            f"Medians of {len(tracked['A'])} flights:",
            _markdown(("point", "amplitude, m", "omega, rad/s", "F_target, rad/(s m)"), rows),
            "As in the paper, the loosely correlated flock has about half the amplitude and nearly twice the "
            "frequency. The paper calls that flock B in this passage, and A everywhere else; here it is A.",
            "![Target](reproduction/target.png)",
        ]
    )


def _cells(front: FlownFront, number: int) -> tuple[str, ...]:
    pairs = zip(front.mean[number], front.deviation[number], strict=True)
    return tuple(f"{mean:.3f} ± {spread:.3f}" for mean, spread in pairs)


def _markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main() -> None:
    """Read the arguments and do the study."""
    parser = argparse.ArgumentParser(description="Do the paper's study and write docs/reproduction.md.")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--logs", type=Path, default=Path("logs/paper"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--named", type=Path, default=NAMED_POINTS)
    asked = parser.parse_args()
    print(reproduce(asked.logs, asked.docs, asked.named, workers=asked.workers, effort=Effort()))


if __name__ == "__main__":
    main()
