"""Studies of many flights that are kept as they end: the same command goes on where it was stopped or killed."""

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
"""Those by which flights may differ."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study:
    """Everything that the flights of a study depend on.

    Attributes:
        verb: of the command that flies it.
        scenario: what is flown.
        settings: all else, as JSON values.
    """

    verb: str
    scenario: Scenario
    settings: Mapping[str, Any]

    def to_json(self) -> str:
        """All but the scenario, which is a file of its own."""
        content = {"study": self.verb, **self.settings, "versions": installed_versions(_LIBRARIES)}
        return json.dumps(content, indent=1) + "\n"

    def default_folder(self) -> Path:
        """A directory in logs/ that the same study finds again, and no other one."""
        text = self.to_json() + self.scenario.to_toml()
        return Path("logs") / f"{self.verb}-{hashlib.blake2b(text.encode(), digest_size=4).hexdigest()}"

    def is_in(self, path: Path) -> bool:
        """Whether a directory is this study's; False if it is still to be made.

        Raises:
            SearchError: it is of another study, or of something else.
        """
        if not is_directory(path):
            check_new(path)
            return False
        there = read_directory(path, _facts)
        here = _facts(self.to_json(), self.scenario.to_toml())
        if there != here:
            names = ", ".join(name for name in {**here, **there} if here.get(name) != there.get(name))
            raise SearchError(
                f"run directory {path}: it has the flights of another study ({names}); name another one, or remove it"
            )
        return True


@contextlib.contextmanager
def open_resumable(
    study: Study, path: Path, job: Job, workers: int, scheduler: str | None
) -> Iterator[ResumableEvaluator]:
    """Workers for a job whose flights stay in a directory, which is made, or gone on with.

    Raises:
        StoppedError: Ctrl-C came first; the message says how to go on.
        MoflockError: the directory is another study's, or it or the workers cannot be had.
    """
    try:
        known = study.is_in(path)
        with make_executor(job, workers, scheduler) as executor:
            if not known:  # workers first: what nobody can fly leaves no directory
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
    """Flies what an archive lacks, and keeps it; the tasks asked for are numbered on from one `evaluate` to the next.

    A flight that failed is flown again: its worker may have been killed.

    Args:
        executor: flies.
        archive: of a study that asks for the same tasks in the same order each time.

    Attributes:
        found: flights that were in the archive at the beginning.
    """

    def __init__(self, executor: Evaluator, archive: Archive) -> None:
        self._executor = executor
        self._archive = archive
        self._known = {flown.number: flown for flown in archive.evaluations() if flown.outcome == OK}
        self._asked = self._parts = 0
        self.found = len(self._known)

    def evaluate(self, tasks: Sequence[EvaluationTask]) -> Iterator[Evaluation]:
        """See `Evaluator`; the tasks' numbers are those from 0.

        Raises:
            SearchError: the archive has another task under a number, or cannot be written.
        """
        first, part = self._asked, self._parts
        self._asked, self._parts = first + len(tasks), part + 1
        recalled = [self._recall(first, task) for task in tasks if first + task.number in self._known]
        yield from recalled
        missing = [task for task in tasks if first + task.number not in self._known]
        for flown in self._executor.evaluate(missing):
            self._archive.append(flown._replace(number=first + flown.number), generation=part)
            yield flown

    def _recall(self, first: int, task: EvaluationTask) -> Evaluation:
        found = self._known[first + task.number]
        if (found.params, found.seeds) != (task.params, task.seeds):
            raise SearchError(
                f"archive {self._archive.path}: flight {found.number} is of another point or seed; remove the directory"
            )
        return found._replace(number=task.number)


def _facts(configuration: str, scenario: str) -> dict[str, Any]:
    """What a directory says of its study, by name."""
    try:
        content = json.loads(configuration)
    except (ValueError, RecursionError) as problem:
        raise SearchError(f"configuration: not JSON: {problem}") from None
    if not isinstance(content, dict):
        raise SearchError("configuration: it must be an object")
    return content | {"scenario": scenario}
