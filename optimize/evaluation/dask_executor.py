"""Executor with the workers of a Dask cluster (the extra `cluster`)."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from types import TracebackType
from typing import Any, Self

from moflock_mj.errors import MoflockError, SearchError
from optimize.evaluation.evaluation import Evaluation, EvaluationTask, Job, evaluate, infeasible, warm_up
from optimize.evaluation.interface import ATTEMPTS

_CONNECT_SECONDS = 5.0
"""Time limit for a connection to the scheduler, s."""

_START_SECONDS = 120.0
"""Time limit for a first worker to join and fly a first flight, compilation included, s."""


class DaskExecutor:
    """Executor on the workers of a Dask scheduler, which moves the tasks of a lost worker to another one.

    Each worker enforces the time limit of an evaluation itself, because Dask cannot interrupt a running task.

    Args:
        job: common settings of all evaluations.
        address: address of the scheduler, such as tcp://host:8786.

    Raises:
        SearchError: `distributed` is not installed, the scheduler or its workers cannot be reached, or the workers
            lack this package.
        MoflockError: the job cannot be flown.
    """

    def __init__(self, job: Job, address: str) -> None:
        try:
            import distributed  # noqa: PLC0415 - an optional dependency
        except ImportError:
            raise SearchError(
                "scheduler: it needs the package distributed: pip install 'moflock-mj[cluster]'"
            ) from None
        self._job = job
        self._as_completed = distributed.as_completed
        try:
            self._client: Any = distributed.Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
        except Exception as error:  # an unusable address raises many different types
            reason = str(error) or type(error).__name__
            raise SearchError(
                f"scheduler {address}: cannot be reached within {_CONNECT_SECONDS:g} s: {reason}"
            ) from None
        try:
            self._check_workers(address)
        except BaseException:
            self.close()
            raise

    @property
    def workers(self) -> int:
        """Current number of threads of all workers of the cluster."""
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
                result = _result_of(future)
                if isinstance(result, Evaluation):
                    yield result
                elif self._client.status != "running":
                    raise SearchError("scheduler: it is gone; the archive holds all evaluations made until now")
                elif attempt < ATTEMPTS:
                    again = self._submit(task)
                    futures[again] = (task, attempt + 1)
                    completed.add(again)
                else:
                    yield infeasible(self._job, task, result, worker="cluster")
                future.release()
        finally:
            if futures:  # the caller stopped before the end
                self._client.cancel(list(futures), force=True)

    def close(self) -> None:
        """See `Executor`. The scheduler and its workers keep running."""
        with contextlib.suppress(OSError, TimeoutError):
            self._client.close(timeout=_CONNECT_SECONDS)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _submit(self, task: EvaluationTask) -> Any:
        # Each task carries the job (a few hundred bytes): data scattered beforehand can be lost with a worker.
        return self._client.submit(evaluate, self._job, task, pure=False)

    def _check_workers(self, address: str) -> None:
        """Fly the job's shortest flight on one worker, to check that it has this package and can fly the job."""
        first = self._client.submit(warm_up, self._job, pure=False)
        try:
            first.result(timeout=_START_SECONDS)
        except MoflockError:
            raise
        except TimeoutError:
            raise SearchError(f"scheduler {address}: no worker has started within {_START_SECONDS:g} s") from None
        except Exception as error:
            raise SearchError(f"scheduler {address}: a worker cannot fly: {type(error).__name__}: {error}") from None


def _result_of(future: Any) -> Evaluation | str:
    """Evaluation of a future, or the reason of its failure."""
    try:
        evaluation: Evaluation = future.result()
    except Exception as error:  # a failure of the flight, the worker or the network: the caller retries the task
        return f"{type(error).__name__}: {error}"
    return evaluation
