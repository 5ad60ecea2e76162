"""A validation from its settings to its findings."""

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
"""Folder of the worst flights' logs in a validation's directory."""


class Terminal(NamedTuple):
    """How a validation reports its progress and is stopped.

    Attributes:
        progress: opens a progress report with this title; called with the flights that are done and all.
        stop: opens what answers whether the user has asked to stop.
    """

    progress: Callable[[str], AbstractContextManager[ProgressCallback]]
    stop: Callable[[], AbstractContextManager[Callable[[], bool]]]


def open_executors(
    settings: ValidationConfig, workers: int, scheduler: str | None, resources: contextlib.ExitStack
) -> list[Executor]:
    """Workers for each of the settings' jobs, that end with the resources.

    Raises:
        MoflockError: none can be had.
    """
    return [resources.enter_context(make_executor(job, workers, scheduler)) for job in settings.jobs()]


def fly_validation(
    run: ValidationDirectory, executors: Sequence[Executor], *, logs: bool, terminal: Terminal
) -> tuple[Validation | None, dict[str, Path]]:
    """Fly what is missing in a directory; None if Ctrl-C came first. The logs of the worst seeds, if asked."""
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
    """Fly what a study's directory lacks, which is made if there is none; its findings and the logs, if asked.

    Raises:
        MoflockError: it cannot be flown or written, or is of another study, or Ctrl-C came before its end.
    """
    run = ValidationDirectory.open(path) if path.exists() else ValidationDirectory.create(path, settings)
    with run, contextlib.ExitStack() as resources:
        if dataclasses.replace(run.settings, versions=settings.versions) != settings:
            raise SearchError(f"run directory {path}: it is of another scenario, other points or seeds; remove it")
        found, logged = fly_validation(
            run, open_executors(settings, workers, None, resources), logs=logs, terminal=terminal
        )
    if found is None:
        raise SearchError(f"run directory {path}: stopped before its end; run it again to go on")
    return found, logged
