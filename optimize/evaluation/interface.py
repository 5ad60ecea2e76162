"""The interfaces of what evaluates parameter sets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Protocol, Self

from optimize.evaluation.evaluation import Evaluation, EvaluationTask

ATTEMPTS = 2
"""Times that a task is tried before it counts as infeasible."""


class Evaluator(Protocol):
    """Flies evaluations, somewhere."""

    def evaluate(self, tasks: Sequence[EvaluationTask]) -> Iterator[Evaluation]:
        """Each task's evaluation, exactly once, in the order in which they are done; none raises."""
        ...


class Executor(Evaluator, Protocol):
    """Flies evaluations with workers of its own."""

    @property
    def workers(self) -> int:
        """How many at a time."""
        ...

    def close(self) -> None:
        """Let go of the workers."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None: ...
