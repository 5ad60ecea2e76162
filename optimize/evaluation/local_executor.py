"""Workers: where evaluations are flown. Local processes here, a Dask cluster in `dask_executor`."""

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
"""s; a worker that has not noticed by itself that its time is over is killed this much later."""


_POLL = 0.5
"""s between two looks at the clock while all workers fly."""


class LocalExecutor:
    """Processes of this machine, each with the job sent once; one that dies, fails or is late is replaced.

    Args:
        job: what is the same for all evaluations.
        workers: number of processes.

    Raises:
        SearchError: fewer than one worker, or none that starts.
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
                worker.answer()
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
                self._kill_late()
                for worker in self._with_news():
                    task, attempt, answer = worker.task, worker.attempt, worker.answer()
                    if isinstance(answer, Evaluation):
                        yield answer
                        continue
                    if task is None:
                        continue  # it has only said that it is ready
                    self._replace(worker)
                    if attempt < ATTEMPTS:
                        waiting.appendleft((task, attempt + 1))
                    else:
                        yield infeasible(self._job, task, answer, worker.busy_seconds, worker.name)
        finally:
            for worker in [worker for worker in self._workers if worker.task]:
                self._replace(worker)  # left in the middle: what it flies is nobody's any more

    def close(self) -> None:
        """See `Executor`."""
        for worker in self._workers:
            worker.end()
        self._workers.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _with_news(self) -> list[_Worker]:
        """Workers that have something to say, which may be that they are dead."""
        expected = {worker.pipe.fileno(): worker for worker in self._workers if not worker.idle}
        return [expected[pipe] for pipe in wait(list(expected), timeout=_POLL) if isinstance(pipe, int)]

    def _kill_late(self) -> None:
        """Kill the workers that are past their time; their pipes end, as those of the dead do."""
        for worker in self._workers:
            if worker.task and self._job.timeout is not None and worker.busy_seconds > self._job.timeout + _GRACE:
                worker.kill()

    def _replace(self, worker: _Worker) -> None:
        worker.end()
        self._workers[self._workers.index(worker)] = _Worker(self._job)


class _Worker:
    """A process and the pipe to it.

    Attributes:
        name: of the process, once it is ready.
        ready: whether it has flown its first, shortest flight.
        task: what it flies.
        attempt: for which time the task is tried.
    """

    def __init__(self, job: Job) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self._job = job
        self._process = context.Process(target=_work, args=(theirs, job), daemon=True)
        with _deaf_to_interrupts():
            self._process.start()
        theirs.close()  # so that the pipe ends when the process does
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
        """Since its task was given to it, s."""
        return time.monotonic() - self._began

    def start(self, task: EvaluationTask, attempt: int) -> None:
        self.task, self.attempt, self._began = task, attempt, time.monotonic()
        with contextlib.suppress(OSError):  # it died while it was idle; its pipe's end will be its answer
            self.pipe.send(task)

    def answer(self) -> Evaluation | str:
        """Read what it has to say: its task's evaluation or why there is none; its name, if it was starting.

        Raises:
            SearchError: it died at its start.
            MoflockError: the job cannot be flown.
        """
        try:
            answer: Evaluation | str | MoflockError = self.pipe.recv()
        except (EOFError, OSError):
            answer = self._epitaph()
        if isinstance(answer, MoflockError):
            raise answer
        if isinstance(answer, str) and not self.ready:
            self.name, self.ready = answer, True
        self.task = None
        return answer

    def kill(self) -> None:
        self._process.kill()

    def end(self) -> None:
        """Kill the process (which holds nothing that is not the parent's too), and wait for its end."""
        self.kill()
        self._process.join()
        self._process.close()
        self.pipe.close()

    def _epitaph(self) -> str | MoflockError:
        self._process.join()
        if not self.ready:
            return SearchError(f"workers: a process died at its start (exit code {self._process.exitcode})")
        if self._job.timeout is not None and self.busy_seconds > self._job.timeout:
            return f"timed out after {self._job.timeout:g} s"
        return f"the worker died (exit code {self._process.exitcode})"


@contextlib.contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Processes that are started meanwhile never notice Ctrl-C in their terminal: it is the parent's affair.

    A new process inherits the mask, and so is deaf from its first instruction on, not only when it has loaded all.
    """
    resource_tracker.ensure_running()  # which `start` would do, and it ends by taking SIGINT off the mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(pipe: Connection, job: Job) -> None:
    """A worker's life: fly what comes, until the parent is gone."""
    with contextlib.suppress(EOFError, OSError):  # the pipe's end: the parent is gone
        pipe.send(_first_words(job))
        while True:
            pipe.send(_answer_to(job, pipe.recv()))


def _first_words(job: Job) -> str | MoflockError:
    try:
        return warm_up(job)
    except MoflockError as problem:
        return problem


def _answer_to(job: Job, task: EvaluationTask) -> Evaluation | str:
    try:
        return evaluate(job, task)
    except Exception as problem:  # whatever it is, the search goes on
        return f"{type(problem).__name__}: {problem}"
