"""Interfaces of evaluators of parameter sets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Protocol, Self

from optimize.evaluation.evaluation import Evaluation, EvaluationTask

ATTEMPTS = 2
"""Number of attempts at a task before it counts as infeasible."""


class Evaluator(Protocol):
    """Evaluator of tasks."""

    def evaluate(self, tasks: Sequence[EvaluationTask]) -> Iterator[Evaluation]:
        """Yield the evaluation of each task once, in the order of completion; a failed task is infeasible."""
        ...


class Executor(Evaluator, Protocol):
    """Evaluator with its own workers."""

    @property
    def workers(self) -> int:
        """Number of tasks evaluated at the same time."""
        ...

    def close(self) -> None:
        """Release the workers."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
