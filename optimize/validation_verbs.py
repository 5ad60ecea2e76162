"""What `moflock validate` and `moflock identify` do, from its arguments to what it prints."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console

from moflock_mj.errors import SearchError
from moflock_mj.identification import identify
from moflock_mj.new_file import new_file
from moflock_mj.scenario import Scenario
from moflock_mj.terminal import INTERRUPTED, stop_on_interrupt
from optimize import identification_page
from optimize.executor import Executor, make_executor
from optimize.figures import save
from optimize.tables import rich_table
from optimize.terminal import flights_progress
from optimize.validation import Settings, Validation, ValidationDirectory, fly_missing, gather, log_worst
from optimize.validation_figures import fronts_figure
from optimize.validation_page import FAULT_LEGEND, FIGURE, LEGEND, dumps, page, tables, to_json, verdict_lines
from optimize.verdict import UNSAFE

PAGE, JSON, LOGS = "validation.md", "validation.json", "logs"
"""Files of a validation's directory, and the folder of its logs."""


def new_validation_path() -> Path:
    """A directory in logs/ that is named for now."""
    return Path("logs") / f"validate-{datetime.datetime.now().astimezone():%Y%m%d-%H%M%S}"


def validate(
    path: Path, settings: Settings | None, *, workers: int, scheduler: str | None, logs: bool, as_json: bool
) -> int:
    """Fly points on both dynamics, judge them, and write all that was found; Ctrl-C ends it so that it can be resumed.

    Args:
        path: a new directory, or with no settings one that is resumed.
        settings: of a new validation.
        workers: local processes.
        scheduler: address of a Dask scheduler that has the workers instead.
        logs: whether the worst seed of each point is logged.
        as_json: whether to print JSON.

    Returns:
        Exit status: 0, or 1 if a point is unsafe.

    Raises:
        MoflockError: what was asked for cannot be flown or written.
    """
    with contextlib.ExitStack() as resources:
        if settings is None:
            run = resources.enter_context(ValidationDirectory.open(path))
            executors = crews(run.settings, workers, scheduler, resources)
        else:  # workers first: what nobody can fly leaves no directory
            settings.check_flyable()
            executors = crews(settings, workers, scheduler, resources)
            run = resources.enter_context(ValidationDirectory.create(path, settings))
        found, logged = validated(run, executors, logs=logs)
    if found is None:
        print(f"stopped; go on with: moflock validate --resume {path}", file=sys.stderr)
        return INTERRUPTED
    content = write(found, logged, path)
    if as_json:
        print(content, end="")
    else:
        print_validation(found, logged, path)
    return int(any(verdict.name == UNSAFE for verdict in found.verdicts))


def crews(settings: Settings, workers: int, scheduler: str | None, resources: contextlib.ExitStack) -> list[Executor]:
    """Workers for each of the settings' jobs, that end with the resources.

    Raises:
        MoflockError: none can be had.
    """
    return [resources.enter_context(make_executor(job, workers, scheduler)) for job in settings.jobs()]


def validated(
    run: ValidationDirectory, executors: Sequence[Executor], *, logs: bool
) -> tuple[Validation | None, dict[str, Path]]:
    """Fly what is missing in a directory; None if Ctrl-C came first. The logs of the worst seeds, if asked."""
    with flights_progress("both dynamics") as told, stop_on_interrupt() as interrupted:
        if not fly_missing(run, executors, told, interrupted):
            return None, {}
    found = gather(run)
    if not logs:
        return found, {}
    with flights_progress("logs of the worst seeds") as told:
        return found, log_worst(found, run.path / LOGS, told)


def take_up(path: Path, settings: Settings, *, workers: int, logs: bool) -> tuple[Validation, dict[str, Path]]:
    """Fly what a study's directory lacks, which is made if there is none; its findings and the logs, if asked.

    Raises:
        MoflockError: it cannot be flown or written, or is of another study, or Ctrl-C came before its end.
    """
    run = ValidationDirectory.open(path) if path.exists() else ValidationDirectory.create(path, settings)
    with run, contextlib.ExitStack() as resources:
        if dataclasses.replace(run.settings, versions=settings.versions) != settings:
            raise SearchError(f"run directory {path}: it is of another scenario, other points or seeds; remove it")
        found, logged = validated(run, crews(settings, workers, None, resources), logs=logs)
    if found is None:
        raise SearchError(f"run directory {path}: stopped before its end; run it again to go on")
    return found, logged


def write(found: Validation, logs: Mapping[str, Path], path: Path) -> str:
    """Write page, figure and JSON into a directory; returns the JSON."""
    content = dumps(to_json(found, logs))
    for name, text in ((JSON, content), (PAGE, page(found, logs))):
        with new_file(path / name) as place:
            place.write_text(text, encoding="utf-8")
    save(lambda: fronts_figure(found), path / FIGURE)
    return content


def print_validation(found: Validation, logs: Mapping[str, Path], path: Path) -> None:
    """Print the tables and where the rest is."""
    console = Console()
    for words in tables(found):
        console.print(rich_table(words))
    for line in (LEGEND, *[FAULT_LEGEND] * bool(found.faults), *verdict_lines(found, logs)):
        console.print(line, highlight=False, soft_wrap=True)
    console.print(f"page: {path / PAGE}", highlight=False, soft_wrap=True)


def identify_airframe(scenario: Scenario, *, out: Path | None, as_json: bool) -> int:
    """Identify the scenario's airframe, print what was found; `out`: the scenario with the calibrated point mass.

    Raises:
        MoflockError: the airframe is unknown or too weak, or the file cannot be written.
    """
    found = identify(scenario)
    if out is not None:
        with new_file(out) as place:
            place.write_text(scenario.replace(point_mass=found.response).to_toml(), encoding="utf-8")
    if as_json:
        print(dumps(identification_page.to_json(found)), end="")
        return 0
    console = Console()
    for words in identification_page.tables(found):
        console.print(rich_table(words))
    if out is not None:
        console.print(f"calibrated scenario: {out}", highlight=False, soft_wrap=True)
    return 0
