"""Execution of a validation: flights, results and logs."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple

from moflock_mj.errors import SearchError
from optimize.evaluation.batch import ProgressCallback
from optimize.evaluation.executors import make_executor
from optimize.evaluation.interface import Executor
from optimize.validation.validation import (
    Validation,
    ValidationConfig,
    ValidationDirectory,
    fly_missing,
    gather,
    log_worst,
)

LOGS = "logs"
"""Folder with the logs of the worst flights in a validation's directory."""


class Terminal(NamedTuple):
    """Progress report and interruption of a validation.

    Attributes:
        progress: opens a progress report with a title; the callback gets the finished and the total number of flights.
        stop: opens a function that returns whether the user has requested to stop.
    """

    progress: Callable[[str], AbstractContextManager[ProgressCallback]]
    stop: Callable[[], AbstractContextManager[Callable[[], bool]]]


def open_executors(
    settings: ValidationConfig, workers: int, scheduler: str | None, resources: contextlib.ExitStack
) -> list[Executor]:
    """Open an executor for each job of the settings; `resources` closes them.

    Raises:
        MoflockError: no worker can be started or reached.
    """
    return [resources.enter_context(make_executor(job, workers, scheduler)) for job in settings.jobs()]


def fly_validation(
    run: ValidationDirectory, executors: Sequence[Executor], *, logs: bool, terminal: Terminal
) -> tuple[Validation | None, dict[str, Path]]:
    """Make the missing flights of a directory.

    Returns:
        The validation, or None if the user has stopped it; and the logs of the worst seeds if `logs` is true.
    """
    with terminal.progress("both dynamics") as progress, terminal.stop() as interrupted:
        if not fly_missing(run, executors, progress, interrupted):
            return None, {}
    found = gather(run)
    if not logs:
        return found, {}
    with terminal.progress("logs of the worst seeds") as progress:
        return found, log_worst(found, run.path / LOGS, progress)


def run_validation(
    path: Path, settings: ValidationConfig, *, workers: int, logs: bool, terminal: Terminal
) -> tuple[Validation, dict[str, Path]]:
    """Make the missing flights of a validation in a new or existing directory.

    Returns:
        The validation, and the logs of the worst seeds if `logs` is true.

    Raises:
        MoflockError: the points cannot be flown, the directory cannot be written or holds another validation, or the
            user has stopped the validation.
    """
    run = ValidationDirectory.open(path) if path.exists() else ValidationDirectory.create(path, settings)
    with run, contextlib.ExitStack() as resources:
        if dataclasses.replace(run.settings, versions=settings.versions) != settings:
            raise SearchError(f"run directory {path}: it is of another scenario, other points or seeds; remove it")
        found, logged = fly_validation(
            run, open_executors(settings, workers, None, resources), logs=logs, terminal=terminal
        )
    if found is None:
        raise SearchError(f"run directory {path}: stopped before the end; run the same command again to resume")
    return found, logged
