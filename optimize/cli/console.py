"""Output of searches: progress bars, tables and JSON."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from controllers.policies.registry import values_of
from moflock_mj.cli.console import stop_on_interrupt
from optimize.evaluation.batch import ProgressCallback as FlightsProgress
from optimize.search.configuration import Configuration
from optimize.search.front import ReevaluatedFront
from optimize.search.search import Progress as SearchCallback
from optimize.search.search import SearchProgress, SearchResult
from optimize.validation.run import Terminal


def new_run_path(algorithm: str) -> Path:
    """Default run directory of a search, named after the current time."""
    now = datetime.datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
    return Path("logs") / f"optimize-{now}-{algorithm}"


@contextlib.contextmanager
def search_progress(configuration: Configuration) -> Iterator[SearchCallback]:
    """Show a progress bar on stderr, if that is a terminal: generation, flights, hypervolume, rate, time left."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(separator=" of "),
        TextColumn("flights"),
        TextColumn("{task.fields[figures]}"),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("first generation", total=configuration.settings.budget, figures="")
        measure = "product" if len(configuration.maximised.names) == 1 else "hypervolume"

        def update(progress: SearchProgress) -> None:
            bar.update(
                task,
                description=f"generation {progress.generation + 1}",
                completed=progress.flights,
                figures=progress_line(progress, measure),
            )

        yield update


@contextlib.contextmanager
def flights_progress(title: str) -> Iterator[FlightsProgress]:
    """Show a progress bar on stderr, if that is a terminal: flights and time left."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(separator=" of "),
        TextColumn("flights"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        # The total is unknown until the first report, which MofNCompleteColumn shows as a question mark.
        task = bar.add_task(title, total=None)
        yield lambda done, of: bar.update(task, completed=done, total=of)


TERMINAL = Terminal(progress=flights_progress, stop=stop_on_interrupt)
"""Progress bars and Ctrl-C of a validation."""


def progress_line(progress: SearchProgress, measure: str = "hypervolume") -> str:
    """Progress of a search in one line; `measure` is the name of its hypervolume."""
    parts = [] if progress.hypervolume is None else [f"{measure} {progress.hypervolume:.3f}"]
    parts.append(f"{progress.rate:.1f} evaluations/s")
    if progress.seconds_left is not None:
        parts.append(f"{datetime.timedelta(seconds=round(progress.seconds_left))} left")
    if progress.screened:
        parts.append(f"{progress.screened} flights on point masses")
    if progress.infeasible:
        parts.append(f"{progress.infeasible} infeasible")
    return "  ".join(parts)


def print_search(
    result: SearchResult, configuration: Configuration, path: Path, front: ReevaluatedFront | None
) -> None:
    """Print a search's front to stdout: on fresh seeds, or as the search estimates it if it was not flown again."""
    console = Console()
    console.print(_flown_table(front) if front else _candidates_table(result, configuration))
    for line in [*_closing_lines(result, configuration, path), *(_front_lines(front, path) if front else [])]:
        console.print(line, highlight=False, soft_wrap=True)


def _flown_table(front: ReevaluatedFront) -> Table:
    """Table of the points on the front, with means and 95 % confidence intervals."""
    table = Table("point", *front.objectives.names, "failed flights", title=f"Front on {len(front.seeds)} fresh seeds")
    for column in table.columns[1:]:
        column.justify = "right"
    for number in front.remaining:
        pairs = zip(front.mean[number], front.half_width[number], strict=True)
        name = f"{number}, knee" if number == front.knee else str(number)
        table.add_row(name, *(f"{mean:.3f} +- {half:.3f}" for mean, half in pairs), str(front.failed[number]))
    return table


def _candidates_table(result: SearchResult, configuration: Configuration) -> Table:
    names = configuration.objectives.names
    table = Table("candidate", *names, *(f"+- {name}" for name in names), "flights")
    for column in table.columns[1:]:
        column.justify = "right"
    for number, estimate in enumerate(sorted(result.front, key=lambda estimate: estimate.mean[0])):
        figures = (*estimate.mean, *estimate.std_error)
        table.add_row(str(number + 1), *(f"{figure:.3f}" for figure in figures), str(estimate.flights))
    return table


def _front_lines(front: ReevaluatedFront, path: Path) -> list[str]:
    return [
        f"hypervolume on {len(front.seeds)} fresh seeds {front.hypervolume:.3f}; "
        f"{len(front.remaining)} of {len(front.points)} points are not dominated",
        f"knee: {objectives_line(front, front.knee)}",
        f"next: moflock pick {path} --out point.json; moflock report {path}",
    ]


def objectives_line(front: ReevaluatedFront, number: int) -> str:
    """Objectives of a point of the front: mean and standard deviation over the flights."""
    triples = zip(front.objectives.names, front.mean[number], front.deviation[number], strict=True)
    return ", ".join(f"{name} {mean:.3f} +- {spread:.3f}" for name, mean, spread in triples)


def front_summary(front: ReevaluatedFront) -> dict[str, Any]:
    """Front on fresh seeds, as JSON values."""
    return {
        "hypervolume": front.hypervolume,
        "seeds": len(front.seeds),
        "objectives": list(front.objectives.names),
        "knee": front.knee,
        "remaining": front.remaining.tolist(),
        "points": front.points[front.remaining].tolist(),
        "mean": front.mean[front.remaining].tolist(),
        "half_width_95": front.half_width[front.remaining].tolist(),
    }


def search_summary(result: SearchResult, configuration: Configuration, path: Path) -> dict[str, Any]:
    """Result of a search, as JSON values."""
    figures = {name: value for name, value in result._asdict().items() if name != "front"}
    return {
        "run": str(path),
        "settings": dataclasses.asdict(configuration.settings),
        "objectives": list(configuration.objectives.names),
        **figures,
        "front": [
            {
                "params": values_of(estimate.params),
                "mean": estimate.mean.tolist(),
                "std_error": estimate.std_error.tolist(),
                "flights": estimate.flights,
            }
            for estimate in result.front
        ],
    }


def _closing_lines(result: SearchResult, configuration: Configuration, path: Path) -> list[str]:
    rate = (result.evaluations - result.replayed) / max(result.seconds, 1e-9)
    lines = [
        f"{result.flights} flights in {result.evaluations} evaluations and {result.generations} generations, "
        f"{result.seconds:.0f} s ({rate:.1f} evaluations/s); hypervolume estimated by the search "
        f"{result.hypervolume:.3f}",
    ]
    if result.replayed:
        lines.append(f"{result.replayed} of the evaluations were read from the archive")
    if result.screened:
        lines.append(f"{result.screened} flights on point masses screened the offspring")
    if result.infeasible:
        lines.append(
            f"{result.infeasible} evaluations were infeasible; the column `outcome` of the archive gives the reasons"
        )
    if not result.complete:
        lines.append(
            f"stopped at {result.flights} of {configuration.settings.budget} flights; go on with --resume {path}"
        )
    lines.append(f"run directory: {path}")
    return lines
