"""Commands `moflock pick` and `moflock report`: choice of a point, and report of a search."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moflock_mj.cli.options import AsJson
from moflock_mj.errors import SearchError
from optimize.cli.options import CORES, FrontSeeds, RunPath, Scheduler, Workers, numbers_of

if TYPE_CHECKING:
    from optimize.search.front import ReevaluatedFront

commands = typer.Typer()


@commands.command("pick", epilog="Example: moflock pick logs/optimize-... --min-f1 0.8 --out point.json")
def pick_command(
    run: RunPath,
    weights: Annotated[
        str | None, typer.Option(help="Weights of the objectives, such as 1,2: choose the largest weighted sum.")
    ] = None,
    min_f1: Annotated[
        float | None, typer.Option(help="Least first objective: choose the best second objective among these points.")
    ] = None,
    knee: Annotated[bool, typer.Option("--knee", help="Choose the knee of the front (default).")] = False,
    seeds: FrontSeeds = None,
    workers: Workers = CORES,
    out: Annotated[Path | None, typer.Option(help="Output file, .json (default: stdout).")] = None,
    as_json: AsJson = False,
) -> int:
    """Choose a point of a run's front and write it as JSON, which `fly --point` and other commands read."""
    given = {"weights": weights is not None, "min_f1": min_f1 is not None, "knee": knee}
    if sum(given.values()) > 1:
        both = " and ".join(name for name, is_given in given.items() if is_given)
        raise SearchError(f"pick: {both} are both given; it must be one of them")
    return pick(
        run,
        weights=numbers_of("weights", weights) if weights is not None else None,
        min_f1=min_f1,
        seeds=seeds,
        workers=workers,
        out=out,
        as_json=as_json,
    )


@commands.command("report", epilog="Example: moflock report logs/optimize-... --compare logs/optimize-...-cmaes")
def report_command(
    run: RunPath,
    compare: Annotated[
        list[Path] | None, typer.Option(help="Directory of another run in the same scenario; may be repeated.")
    ] = None,
    seeds: FrontSeeds = None,
    workers: Workers = CORES,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, typer.Option(help="Output folder (default: RUN/report).")] = None,
    as_json: AsJson = False,
) -> int:
    """Write a report of a run: one HTML page with all figures, and the figures as PNG files."""
    return report(
        run, compared=compare or (), seeds=seeds, workers=workers, scheduler=scheduler, out=out, as_json=as_json
    )


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
    """Choose a point of a run's front on fresh seeds, and write it as JSON to `out` or to stdout.

    Raises:
        MoflockError: the run cannot be read, no point meets the conditions, or the file cannot be written.
    """
    from moflock_mj.files import new_file
    from optimize.cli.console import objectives_line
    from optimize.search.front import choose, point_json

    front = _front_of(run, seeds, workers)
    number = choose(front, weights=weights, min_f1=min_f1)
    conditions = {"weights": weights, "min_f1": min_f1}
    rule = ", ".join(f"{name} {value}" for name, value in conditions.items() if value is not None) or "knee"
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
    """Write a report of a run, by default into its directory, and compare it with other runs.

    Raises:
        MoflockError: a run cannot be read or has no evaluations, or a file cannot be written.
    """
    from optimize.cli.console import flights_progress, front_summary, objectives_line
    from optimize.evaluation.executors import make_executor
    from optimize.reports.search_report import write_report
    from optimize.search.findings import gather
    from optimize.search.run_directory import RunDirectory

    with contextlib.ExitStack() as resources:
        directory = resources.enter_context(RunDirectory.open(run))
        others = [resources.enter_context(RunDirectory.open(other)) for other in compared]
        executor = resources.enter_context(make_executor(directory.configuration.job, workers, scheduler))
        progress = resources.enter_context(flights_progress("front on fresh seeds"))
        found = gather(directory, executor, compared=others, seeds=seeds, progress=progress)
    page = write_report(found, out or run / "report")
    front = found.front
    if as_json:
        print(json.dumps(front_summary(front) | {"page": str(page)}, indent=1))
    else:
        print(f"hypervolume on {len(front.seeds)} fresh seeds {front.hypervolume:.3f}; {len(front.remaining)} points")
        print(f"knee: {objectives_line(front, front.knee)}")
        print(f"report: {page}")
    return 0


def _front_of(run: Path, seeds: int | None, workers: int) -> ReevaluatedFront:
    from optimize.cli.console import flights_progress
    from optimize.evaluation.executors import make_executor
    from optimize.search.findings import flown_front
    from optimize.search.run_directory import RunDirectory

    with contextlib.ExitStack() as resources:
        directory = resources.enter_context(RunDirectory.open(run))
        executor = resources.enter_context(make_executor(directory.configuration.job, workers))
        progress = resources.enter_context(flights_progress("front on fresh seeds"))
        return flown_front(directory, executor, seeds, progress)
