"""Executor with worker processes on this machine."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import time
from collections import deque
from collections.abc import Iterator, Sequence
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from types import TracebackType
from typing import Self

from moflock_mj.errors import MoflockError, SearchError
from optimize.evaluation.evaluation import Evaluation, EvaluationTask, Job, evaluate, infeasible, warm_up
from optimize.evaluation.interface import ATTEMPTS

_GRACE = 5.0
"""Time after the time limit at which a worker that has not stopped by itself is killed, s."""


_POLL = 0.5
"""Interval between two checks of the time limit while all workers are busy, s."""


class LocalExecutor:
    """Executor with local processes; a process that dies, fails or exceeds the time limit is replaced.

    Args:
        job: common settings of all evaluations; sent once to each process.
        workers: number of processes.

    Raises:
        SearchError: the number of workers is out of bounds, or a worker does not start.
        MoflockError: the job cannot be flown.
    """

    def __init__(self, job: Job, workers: int = 1) -> None:
        if not 1 <= workers <= 1024:
            raise SearchError(f"workers: {workers} is out of bounds: it must be at least 1 and at most 1024")
        self.workers = workers
        self._job = job
        self._workers: list[_Worker] = []
        try:
            self._workers.extend(_Worker(job) for _ in range(workers))
            for worker in self._workers:
                worker.receive()
        except BaseException:
            self.close()
            raise

    def evaluate(self, tasks: Sequence[EvaluationTask]) -> Iterator[Evaluation]:
        """See `Executor`."""
        waiting = deque((task, 1) for task in tasks)
        try:
            while waiting or any(worker.task for worker in self._workers):
                for worker in self._workers:
                    if waiting and worker.idle:
                        worker.start(*waiting.popleft())
                self._kill_overdue()
                for worker in self._ready_to_read():
                    task, attempt, result = worker.task, worker.attempt, worker.receive()
                    if isinstance(result, Evaluation):
                        yield result
                        continue
                    if task is None:
                        continue  # the worker has only reported that it is ready
                    self._replace(worker)
                    if attempt < ATTEMPTS:
                        waiting.appendleft((task, attempt + 1))
                    else:
                        yield infeasible(self._job, task, result, worker.busy_seconds, worker.name)
        finally:
            for worker in [worker for worker in self._workers if worker.task]:
                self._replace(worker)  # the caller stopped before the end: these results are not needed

    def close(self) -> None:
        """See `Executor`."""
        for worker in self._workers:
            worker.end()
        self._workers.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _ready_to_read(self) -> list[_Worker]:
        """Workers with a message in their pipe, or whose pipe is closed."""
        expected = {worker.pipe.fileno(): worker for worker in self._workers if not worker.idle}
        return [expected[pipe] for pipe in wait(list(expected), timeout=_POLL) if isinstance(pipe, int)]

    def _kill_overdue(self) -> None:
        """Kill the workers that have exceeded the time limit; `_ready_to_read` then returns them."""
        for worker in self._workers:
            if worker.task and self._job.timeout is not None and worker.busy_seconds > self._job.timeout + _GRACE:
                worker.kill()

    def _replace(self, worker: _Worker) -> None:
        worker.end()
        self._workers[self._workers.index(worker)] = _Worker(self._job)


class _Worker:
    """Worker process with its pipe.

    Attributes:
        name: name of the process; empty until it is ready.
        ready: whether the process has flown its warm-up flight.
        task: the current task, or None.
        attempt: number of the attempt at the task, from 1.
    """

    def __init__(self, job: Job) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, child_pipe = context.Pipe()
        self._job = job
        self._process = context.Process(target=_work, args=(child_pipe, job), daemon=True)
        with _interrupts_blocked():
            self._process.start()
        child_pipe.close()  # so that the pipe is closed when the process ends
        self._began = 0.0
        self.name = ""
        self.ready = False
        self.task: EvaluationTask | None = None
        self.attempt = 0

    @property
    def idle(self) -> bool:
        return self.ready and self.task is None

    @property
    def busy_seconds(self) -> float:
        """Time since the task was sent, s."""
        return time.monotonic() - self._began

    def start(self, task: EvaluationTask, attempt: int) -> None:
        self.task, self.attempt, self._began = task, attempt, time.monotonic()
        with contextlib.suppress(OSError):  # the process died while idle; its closed pipe is detected later
            self.pipe.send(task)

    def receive(self) -> Evaluation | str:
        """Read a message: the evaluation of the task, the reason of its failure, or the name of a new process.

        Raises:
            SearchError: the process died at its start.
            MoflockError: the job cannot be flown.
        """
        try:
            result: Evaluation | str | MoflockError = self.pipe.recv()
        except (EOFError, OSError):
            result = self._reason_of_death()
        if isinstance(result, MoflockError):
            raise result
        if isinstance(result, str) and not self.ready:
            self.name, self.ready = result, True
        self.task = None
        return result

    def kill(self) -> None:
        self._process.kill()

    def end(self) -> None:
        """Kill the process, which holds no state of its own, and wait for its end."""
        self.kill()
        self._process.join()
        self._process.close()
        self.pipe.close()

    def _reason_of_death(self) -> str | MoflockError:
        self._process.join()
        if not self.ready:
            return SearchError(f"workers: a process died at its start (exit code {self._process.exitcode})")
        if self._job.timeout is not None and self.busy_seconds > self._job.timeout:
            return f"timed out after {self._job.timeout:g} s"
        return f"the worker died (exit code {self._process.exitcode})"


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT for processes started in this context, so that only the parent handles Ctrl-C.

    A new process inherits the signal mask, so SIGINT is blocked from its first instruction.
    """
    resource_tracker.ensure_running()  # `start` would do this otherwise, and would remove SIGINT from the mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(pipe: Connection, job: Job) -> None:
    """Evaluate tasks from the pipe until the parent closes it."""
    with contextlib.suppress(EOFError, OSError):  # the parent has closed the pipe
        pipe.send(_warm_up(job))
        while True:
            pipe.send(_evaluate(job, pipe.recv()))


def _warm_up(job: Job) -> str | MoflockError:
    try:
        return warm_up(job)
    except MoflockError as error:
        return error


def _evaluate(job: Job, task: EvaluationTask) -> Evaluation | str:
    try:
        return evaluate(job, task)
    except Exception as error:  # any failure of a flight must leave the worker running
        return f"{type(error).__name__}: {error}"
