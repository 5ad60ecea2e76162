"""Command `moflock validate`: flights of points as point masses and as rigid bodies."""

from __future__ import annotations

import contextlib
import datetime
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moflock_mj.cli.options import AsJson, Drones, ScenarioFile, given_scenario
from optimize.cli.options import (
    CORES,
    Duration,
    Scheduler,
    Workers,
    refuse_with_resume,
)

if TYPE_CHECKING:
    from optimize.validation.validation import Validation, ValidationConfig

commands = typer.Typer()


_VALIDATE_EXAMPLE = "Example: moflock validate A knee logs/optimize-... --seeds 20; moflock validate --resume RUN"


@commands.command("validate", epilog=_VALIDATE_EXAMPLE)
def validate_command(
    points: Annotated[
        list[str] | None, typer.Argument(help="Named points, .json files or search directories.", metavar="POINT...")
    ] = None,
    seeds: Annotated[int | None, typer.Option(help="Flights of each point with each dynamics (default: 20).")] = None,
    faults: Annotated[bool, typer.Option("--faults", help="Also fly the standard faults as rigid bodies.")] = False,
    fault_seeds: Annotated[int | None, typer.Option(help="Flights of each point with each fault (default: 5).")] = None,
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Duration = None,
    workers: Workers = CORES,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, typer.Option(help="Output directory (default: a new one in logs/).")] = None,
    resume: Annotated[Path | None, typer.Option(help="Resume this validation.", metavar="RUN")] = None,
    logs: Annotated[bool, typer.Option(help="Log the worst seed of each point.")] = True,
    as_json: AsJson = False,
) -> int:
    """Fly points as point masses and as rigid bodies, and report which are safe and which faults they survive."""
    from optimize.validation.validation import FAULT_SEEDS, make_settings

    if resume is not None:
        given: dict[str, Any] = {"points": points or None, "seeds": seeds, "scenario": scenario}
        given |= {"drones": drones, "duration": duration, "out": out}
        given |= {"faults": faults or None, "fault_seeds": fault_seeds}
        refuse_with_resume(given)
        settings, path = None, resume
    else:
        flown = given_scenario(scenario, drones=drones, duration=duration)
        count = _SEEDS if seeds is None else seeds
        fault_count = fault_seeds if fault_seeds is not None else min(FAULT_SEEDS, count) * faults
        settings = make_settings(flown, points or [], count, fault_count)
        path = out or new_validation_path()
    return validate(path, settings, workers=workers, scheduler=scheduler, logs=logs, as_json=as_json)


def new_validation_path() -> Path:
    """Default directory of a validation, named after the current time."""
    return Path("logs") / f"validate-{datetime.datetime.now().astimezone():%Y%m%d-%H%M%S}"


def validate(
    path: Path, settings: ValidationConfig | None, *, workers: int, scheduler: str | None, logs: bool, as_json: bool
) -> int:
    """Fly points with both dynamics, and write verdicts, tables and a figure. Ctrl-C stops; it can be resumed.

    Args:
        path: a new directory, or an existing one if `settings` is None.
        settings: settings of a new validation; None to resume.
        workers: number of local processes.
        scheduler: address of a Dask scheduler, which replaces local processes; or None.
        logs: whether the worst seed of each point is logged.
        as_json: whether to print JSON.

    Returns:
        Exit status: 0, or 1 if a point is unsafe.

    Raises:
        MoflockError: the points cannot be flown, or a file cannot be written.
    """
    from moflock_mj.cli.options import INTERRUPTED
    from moflock_mj.metrics.verdict import UNSAFE
    from optimize.cli.console import TERMINAL
    from optimize.reports.validation_page import write
    from optimize.validation.run import fly_validation, open_executors
    from optimize.validation.validation import ValidationDirectory

    with contextlib.ExitStack() as resources:
        if settings is None:
            run = resources.enter_context(ValidationDirectory.open(path))
            executors = open_executors(run.settings, workers, scheduler, resources)
        else:  # the workers first, so that a failure leaves no directory
            settings.check_flyable()
            executors = open_executors(settings, workers, scheduler, resources)
            run = resources.enter_context(ValidationDirectory.create(path, settings))
        found, logged = fly_validation(run, executors, logs=logs, terminal=TERMINAL)
    if found is None:
        print(f"stopped; go on with: moflock validate --resume {path}", file=sys.stderr)
        return INTERRUPTED
    content = write(found, logged, path)
    if as_json:
        print(content, end="")
    else:
        print_validation(found, logged, path)
    return int(any(verdict.name == UNSAFE for verdict in found.verdicts))


def print_validation(found: Validation, logs: Mapping[str, Path], path: Path) -> None:
    """Print the tables, the verdicts and the path of the page."""
    from rich.console import Console

    from optimize.reports.tables import rich_table
    from optimize.reports.validation_page import FAULT_LEGEND, LEGEND, PAGE, tables, verdict_lines

    console = Console()
    for words in tables(found):
        console.print(rich_table(words))
    for line in (LEGEND, *[FAULT_LEGEND] * bool(found.faults), *verdict_lines(found, logs)):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(f"page: {path / PAGE}", highlight=False, soft_wrap=True)


_SEEDS = 20
