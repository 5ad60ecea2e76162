"""Studies of many flights, archived as they end: the same command resumes a study that was stopped or killed."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from controllers.policies.registry import POLICIES
from moflock_mj.errors import SearchError, StoppedError
from moflock_mj.scenario.scenario import Scenario
from optimize.evaluation.archive import (
    Archive,
    check_new,
    installed_versions,
    is_directory,
    read_directory,
    write_directory,
)
from optimize.evaluation.evaluation import OK, Evaluation, EvaluationTask, Job
from optimize.evaluation.executors import make_executor
from optimize.evaluation.interface import Evaluator

_LIBRARIES = ("moflock-mj", "mujoco", "numba", "numpy", "scipy", "control")
"""Libraries on which the results of flights may depend."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study:
    """All inputs on which the flights of a study depend.

    Attributes:
        command: name of the command that runs the study.
        scenario: scenario of the flights.
        settings: all other inputs, as JSON values.
    """

    command: str
    scenario: Scenario
    settings: Mapping[str, Any]

    def to_json(self) -> str:
        """JSON text of all inputs but the scenario, which is stored in a separate file."""
        content = {"study": self.command, **self.settings, "versions": installed_versions(_LIBRARIES)}
        return json.dumps(content, indent=1) + "\n"

    def default_folder(self) -> Path:
        """Directory in logs/ with a name that depends on all inputs of the study."""
        text = self.to_json() + self.scenario.to_toml()
        return Path("logs") / f"{self.command}-{hashlib.blake2b(text.encode(), digest_size=4).hexdigest()}"

    def is_in(self, path: Path) -> bool:
        """Whether a directory holds this study; False if the directory is empty or does not exist.

        Raises:
            SearchError: the directory holds another study or other files.
        """
        if not is_directory(path):
            check_new(path)
            return False
        stored = read_directory(path, _inputs)
        current = _inputs(self.to_json(), self.scenario.to_toml())
        if stored != current:
            names = ", ".join(name for name in {**current, **stored} if current.get(name) != stored.get(name))
            raise SearchError(
                f"run directory {path}: it has the flights of another study ({names}); "
                "choose another directory or remove this one"
            )
        return True


@contextlib.contextmanager
def open_resumable(
    study: Study, path: Path, job: Job, workers: int, scheduler: str | None
) -> Iterator[ResumableEvaluator]:
    """Open an evaluator for a job that archives its flights in a new directory, or resumes an existing one.

    Raises:
        StoppedError: Ctrl-C was pressed; the message says how to resume.
        MoflockError: the directory holds another study or cannot be written, or the workers cannot be started.
    """
    try:
        known = study.is_in(path)
        with make_executor(job, workers, scheduler) as executor:
            if not known:  # after the workers have started, so that a failure leaves no directory
                write_directory(path, study.scenario, study.to_json())
            with Archive(path, POLICIES[job.policy]) as archive, archive.locked():
                archive.count_damaged()
                archive.repair()
                flights = ResumableEvaluator(executor, archive)
                if flights.found:
                    print(f"{flights.found} flights are in {path} already", file=sys.stderr)
                yield flights
    except KeyboardInterrupt:
        raise StoppedError(f"stopped; go on with the same command: its flights are kept in {path}") from None


class ResumableEvaluator:
    """Evaluator that runs and archives only the tasks that an archive lacks.

    The numbers of the tasks continue from one call of `evaluate` to the next. Failed flights are repeated, because a
    failure may have been that of the worker.

    Args:
        executor: evaluator of the missing tasks.
        archive: archive of a study that requests the same tasks in the same order each time.

    Attributes:
        found: number of flights that were in the archive at the beginning.
    """

    def __init__(self, executor: Evaluator, archive: Archive) -> None:
        self._executor = executor
        self._archive = archive
        self._known = {flown.number: flown for flown in archive.evaluations() if flown.outcome == OK}
        self._requested = self._calls = 0
        self.found = len(self._known)

    def evaluate(self, tasks: Sequence[EvaluationTask]) -> Iterator[Evaluation]:
        """See `Evaluator`; the tasks must be numbered from 0.

        Raises:
            SearchError: the archive has another task under the same number, or cannot be written.
        """
        first, call = self._requested, self._calls
        self._requested, self._calls = first + len(tasks), call + 1
        recalled = [self._recall(first, task) for task in tasks if first + task.number in self._known]
        yield from recalled
        missing = [task for task in tasks if first + task.number not in self._known]
        for flown in self._executor.evaluate(missing):
            self._archive.append(flown._replace(number=first + flown.number), generation=call)
            yield flown

    def _recall(self, first: int, task: EvaluationTask) -> Evaluation:
        found = self._known[first + task.number]
        if (found.params, found.seeds) != (task.params, task.seeds):
            raise SearchError(
                f"archive {self._archive.path}: flight {found.number} has another point or seed; remove the directory"
            )
        return found._replace(number=task.number)


def _inputs(configuration: str, scenario: str) -> dict[str, Any]:
    """Inputs of the study of a directory, by name."""
    try:
        content = json.loads(configuration)
    except (ValueError, RecursionError) as error:
        raise SearchError(f"configuration: not JSON: {error}") from None
    if not isinstance(content, dict):
        raise SearchError("configuration: it must be an object")
    return content | {"scenario": scenario}
