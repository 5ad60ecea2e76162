"""What the commands of `commands` do, from their arguments to what they print."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from moflock_mj.bounds import Bounds
from moflock_mj.new_file import new_file
from moflock_mj.points import load_point
from moflock_mj.scenario import Scenario
from moflock_mj.target import track_target
from moflock_mj.terminal import INTERRUPTED, stop_on_interrupt
from optimize.archive import RunDirectory
from optimize.configuration import Configuration, search_scenario
from optimize.evaluation import Job
from optimize.executor import Executor, make_executor
from optimize.figures import components_figure, save
from optimize.findings import flown_front, gather
from optimize.flight_figures import target_figure
from optimize.fly_points import check_counts
from optimize.front import SEEDS, FlownFront, choose, point_json
from optimize.kept_flights import Study, kept_flights
from optimize.objectives import Objectives
from optimize.pca import Agreement, PrincipalComponents, agreement, components_json, grouped_by_sign, study
from optimize.reference import FIRST_COMPONENT
from optimize.report import write_report
from optimize.search import search
from optimize.terminal import (
    flights_progress,
    front_summary,
    objectives_line,
    print_search,
    search_progress,
    search_summary,
)


def pca(
    *,
    scenario: Scenario,
    dynamics: str,
    bounds: Bounds,
    points: int,
    seed: int,
    sampling: str,
    workers: int,
    scheduler: str | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Fly random points, analyse their fitnesses, print the matrices.

    `out` gets JSON for `optimize`; a figure and a folder of the flights go beside it. Without it the flights alone
    are kept, in `logs/`.

    Raises:
        MoflockError: what was asked for cannot be flown or written.
    """
    check_counts(points=points)
    scenario = search_scenario(scenario, dynamics)
    job = Job(scenario=scenario, dynamics=dynamics)
    settings = {"dynamics": dynamics, "bounds": bounds.to_dict(), "points": points, "seed": seed, "sampling": sampling}
    asked = Study(verb="pca", scenario=scenario, settings=settings)
    folder = out.with_suffix(".flights") if out else asked.default_folder()
    with kept_flights(asked, folder, job, workers, scheduler) as flights:
        with flights_progress("random points") as told:
            found, _ = study(flights, bounds, points=points, seed=seed, sampling=sampling, told=told)
        objectives = grouped_by_sign(found, scenario)
        if out is not None:
            with new_file(out) as place:
                place.write_text(components_json(found, objectives), encoding="utf-8")
            labels = [f"F_{name}" for name in found.names]
            save(
                lambda: components_figure(found, labels, "Covariance of the fitnesses", FIRST_COMPONENT),
                out.with_suffix(".png"),
            )
    near = agreement(found)
    if as_json:
        print(json.dumps({**json.loads(components_json(found, objectives)), "agreement": near._asdict()}, indent=1))
    else:
        _print_components(found, objectives, near)
        print(f"flights: {folder}")
    return 0


def optimize(
    path: Path,
    configuration: Configuration | None,
    *,
    workers: int,
    scheduler: str | None,
    seeds: int = SEEDS,
    as_json: bool,
) -> int:
    """Search, then fly the front again on fresh seeds; Ctrl-C ends it so that it can be resumed.

    Args:
        path: the run directory: a new one, or with no configuration one that is resumed.
        configuration: of a new search.
        workers: local processes.
        scheduler: address of a Dask scheduler that has the workers instead.
        seeds: fresh seeds for the front; 0 for none.
        as_json: whether to print JSON.

    Raises:
        MoflockError: what was asked for cannot be searched, or written.
    """
    with contextlib.ExitStack() as resources:
        if configuration is None:
            run = resources.enter_context(RunDirectory.open(path))
            executor, screening = crews(run.configuration, workers, scheduler, resources)
        else:  # workers first: a search that nobody can fly leaves no directory
            executor, screening = crews(configuration, workers, scheduler, resources)
            run = resources.enter_context(RunDirectory.create(path, configuration))
        if (damaged := run.count_damaged()) and not as_json:
            print(f"{damaged} evaluations of the archive are damaged, and are flown again", file=sys.stderr)
        with search_progress(run.configuration) as progress, stop_on_interrupt() as interrupted:
            result = search(run, executor, progress, interrupted, screening=screening)
        front = None
        if result.complete and seeds:
            with flights_progress("front on fresh seeds") as told:
                front = flown_front(run, executor, seeds, told)
    summary = search_summary(result, run.configuration, path)
    if as_json:
        print(json.dumps(summary | {"flown_front": front_summary(front) if front else None}, indent=1))
    else:
        print_search(result, run.configuration, path, front)
    return 0 if result.complete else INTERRUPTED


def crews(
    configuration: Configuration, workers: int, scheduler: str | None, resources: contextlib.ExitStack
) -> tuple[Executor, Executor | None]:
    """Workers of a search, and those of the point masses by which it is screened, if it is; they end with `resources`.

    Raises:
        MoflockError: none can be had.
    """
    own, screening = (
        resources.enter_context(make_executor(job, workers, scheduler)) if job else None
        for job in (configuration.job, configuration.screening_job)
    )
    assert own is not None  # for the type checker
    return own, screening


def pick(
    run: Path,
    *,
    weights: Sequence[float] | None,
    min_f1: float | None,
    seeds: int | None = None,
    workers: int,
    out: Path | None,
    as_json: bool,
) -> int:
    """Choose a point of a run's front as flown on fresh seeds, and write it as JSON, to `out` or to stdout.

    Raises:
        MoflockError: no run, no such point, or a file that cannot be written.
    """
    front = _front_of(run, seeds, workers)
    number = choose(front, weights=weights, min_f1=min_f1)
    asked = {"weights": weights, "min_f1": min_f1}
    rule = ", ".join(f"{name} {value}" for name, value in asked.items() if value is not None) or "knee"
    text = point_json(front, number, rule=rule)
    if out is None or as_json:
        print(text, end="")
    if out is not None:
        with new_file(out) as place:
            place.write_text(text, encoding="utf-8")
        if not as_json:
            print(f"{rule}: {objectives_line(front, number)}; {out}")
    return 0


def report(
    run: Path,
    *,
    compared: Sequence[Path] = (),
    seeds: int | None = None,
    workers: int,
    scheduler: str | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Write a run's report, by default into its directory; other runs may be compared.

    Raises:
        MoflockError: no run, nothing evaluated, or a file that cannot be written.
    """
    with contextlib.ExitStack() as resources:
        directory = resources.enter_context(RunDirectory.open(run))
        others = [resources.enter_context(RunDirectory.open(other)) for other in compared]
        executor = resources.enter_context(make_executor(directory.configuration.job, workers, scheduler))
        told = resources.enter_context(flights_progress("front on fresh seeds"))
        found = gather(directory, executor, compared=others, seeds=seeds, told=told)
    page = write_report(found, out or run / "report")
    front = found.front
    if as_json:
        print(json.dumps(front_summary(front) | {"page": str(page)}, indent=1))
    else:
        print(f"hypervolume on {len(front.seeds)} fresh seeds {front.hypervolume:.3f}; {len(front.remaining)} points")
        print(f"knee: {objectives_line(front, front.knee)}")
        print(f"report: {page}")
    return 0


def target(
    points: Sequence[str],
    *,
    place: tuple[float, float],
    scenario: Scenario,
    dynamics: str,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> int:
    """Fly flocks around a target, print the fitted sines; `out`: a figure of them, .png.

    Raises:
        MoflockError: what was asked for cannot be flown or written.
    """
    results = [
        track_target(load_point(point), target=place, scenario=scenario, dynamics=dynamics, seed=seed)
        for point in points
    ]
    if out is not None:
        save(lambda: target_figure(results, [f"Point {Path(point).stem}" for point in points]), out)
    figures = [
        {"point": point, **result.sine._asdict(), "residual": result.residual, "F_target": result.F_target}
        for point, result in zip(points, results, strict=True)
    ]
    if as_json:
        print(json.dumps({"target": list(place), "dynamics": dynamics, "seed": seed, "flocks": figures}, indent=1))
        return 0
    table = Table("point", "amplitude, m", "omega, rad/s", "offset, m", "residual, m", "F_target, rad/(s m)")
    for facts in figures:
        columns = ("amplitude", "omega", "offset", "residual", "F_target")
        table.add_row(str(facts["point"]), *(f"{facts[name]:.4g}" for name in columns))
    Console().print(table)
    return 0


def _front_of(run: Path, seeds: int | None, workers: int) -> FlownFront:
    with contextlib.ExitStack() as resources:
        directory = resources.enter_context(RunDirectory.open(run))
        executor = resources.enter_context(make_executor(directory.configuration.job, workers))
        told = resources.enter_context(flights_progress("front on fresh seeds"))
        return flown_front(directory, executor, seeds, told)


def _print_components(found: PrincipalComponents, objectives: Objectives, near: Agreement) -> None:
    table = Table("", "w", *(f"F_{name}" for name in found.names), title=f"{found.samples} random points: w and K")
    for name, weight, row in zip(found.names, found.components[0], found.covariance, strict=True):
        table.add_row(f"F_{name}", f"{weight:.3f}", *(f"{value:.3f}" for value in row))
    console = Console()
    console.print(table)
    console.print("explained variance, %: " + ", ".join(f"{100 * share:.1f}" for share in found.explained))
    for name, group in zip(objectives.names, objectives.groups, strict=True):
        console.print(f"{name} = " + " ".join(f"F_{member}" for member in group), highlight=False)
    for name in found.constant:
        console.print(f"F_{name} never varied", highlight=False)
    signs = "the same signs" if near.same_signs else "other signs"
    console.print(
        f"beside the paper's: cosine {near.cosine:.3f}, {signs}, covariance differs by {near.covariance_error:.3f}",
        highlight=False,
    )
