"""Workers on many machines: the same evaluations on a Dask distributed cluster (the extra `cluster`)."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Any, Self

from moflock_mj.errors import MoflockError, SearchError
from optimize.evaluation.evaluation import Evaluation, EvaluationTask, Job, evaluate, infeasible, warm_up
from optimize.evaluation.interface import ATTEMPTS

_CONNECT_SECONDS = 5.0
"""A scheduler that has not answered by then counts as unreachable."""

_START_SECONDS = 120.0
"""Time for a first worker to appear and to fly its first flight, which may have to be compiled."""


class DaskExecutor:
    """The workers of a Dask scheduler. A task whose worker is lost is given to another one by the scheduler.

    A worker that does not end its evaluation in time notices by itself; Dask cannot break it off.

    Args:
        job: what is the same for all evaluations.
        address: of the scheduler, such as tcp://host:8786.

    Raises:
        SearchError: `distributed` is not installed, or the scheduler or a worker of it cannot be reached, or the
            worker lacks this package.
        MoflockError: the job cannot be flown.
    """

    def __init__(self, job: Job, address: str) -> None:
        try:
            import distributed  # noqa: PLC0415 - an extra
        except ImportError:
            raise SearchError(
                "scheduler: it takes the package distributed: pip install 'moflock-mj[cluster]'"
            ) from None
        self._job = job
        self._as_completed = distributed.as_completed
        try:
            self._client: Any = distributed.Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
        except Exception as problem:  # by what is wrong with the address, it raises nearly anything
            reason = str(problem) or type(problem).__name__
            raise SearchError(
                f"scheduler {address}: cannot be reached within {_CONNECT_SECONDS:g} s: {reason}"
            ) from None
        try:
            self._meet_workers(address)
        except BaseException:
            self.close()
            raise

    @property
    def workers(self) -> int:
        """Threads of all workers of the cluster by now."""
        return max(sum(map(int, self._client.nthreads().values())), 1)

    def evaluate(self, tasks: Sequence[EvaluationTask]) -> Iterator[Evaluation]:
        """See `Executor`."""
        if not tasks:
            return
        futures = {self._submit(task): (task, 1) for task in tasks}
        completed = self._as_completed(list(futures), loop=self._client.loop)
        try:
            for future in completed:
                task, attempt = futures.pop(future)
                answer = _answer_of(future)
                if isinstance(answer, Evaluation):
                    yield answer
                elif self._client.status != "running":
                    raise SearchError("scheduler: it is gone; the archive has what was flown until now")
                elif attempt < ATTEMPTS:
                    again = self._submit(task)
                    futures[again] = (task, attempt + 1)
                    completed.add(again)
                else:
                    yield infeasible(self._job, task, answer, worker="cluster")
                future.release()
        finally:
            if futures:  # left in the middle
                self._client.cancel(list(futures), force=True)

    def close(self) -> None:
        """See `Executor`. The scheduler and its workers stay."""
        with contextlib.suppress(OSError, TimeoutError):
            self._client.close(timeout=_CONNECT_SECONDS)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _submit(self, task: EvaluationTask) -> Any:
        # The job goes with each task (it is a few hundred bytes): data scattered beforehand can die with a worker.
        return self._client.submit(evaluate, self._job, task, pure=False)

    def _meet_workers(self, address: str) -> None:
        """Let one worker fly the job's shortest flight: it is there, it has this package, and the job can be flown."""
        first = self._client.submit(warm_up, self._job, pure=False)
        try:
            first.result(timeout=_START_SECONDS)
        except MoflockError:
            raise
        except TimeoutError:
            raise SearchError(f"scheduler {address}: no worker has started within {_START_SECONDS:g} s") from None
        except Exception as problem:
            raise SearchError(
                f"scheduler {address}: a worker cannot fly: {type(problem).__name__}: {problem}"
            ) from None


def _answer_of(future: Any) -> Evaluation | str:
    """A future's evaluation, or why there is none."""
    try:
        evaluation: Evaluation = future.result()
    except Exception as problem:  # of the flight, of its worker or of the way to it; the search decides what follows
        return f"{type(problem).__name__}: {problem}"
    return evaluation
