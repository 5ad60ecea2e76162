"""Search loop: ask the algorithm for points, evaluate and archive them, and return the results to the algorithm."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moflock_mj.errors import SearchError
from optimize.evaluation.archive import Archive, installed_versions
from optimize.evaluation.evaluation import OK, Evaluation, EvaluationTask
from optimize.evaluation.executors import make_executor
from optimize.evaluation.interface import Executor
from optimize.search.algorithms import make_algorithm
from optimize.search.allocation import BudgetAllocator, EvaluationBatch, noise_policy
from optimize.search.configuration import Configuration
from optimize.search.estimates import Estimate, estimated_front, hypervolume
from optimize.search.run_directory import RunDirectory


class SearchProgress(NamedTuple):
    """Progress of a search.

    Attributes:
        generation: number of the current generation, from 0.
        evaluations: finished evaluations, with those from the archive and those of the screening.
        flights: finished flights, without those of the screening.
        screened: finished flights of the screening.
        budget: total number of flights.
        hypervolume: hypervolume as the search estimates it; None before the end of the first generation.
        rate: evaluations per second since this session began.
        seconds_left: estimated time left, s; None before the first flight.
        infeasible: number of infeasible evaluations.
    """

    generation: int
    evaluations: int
    flights: int
    screened: int
    budget: int
    hypervolume: float | None
    rate: float
    seconds_left: float | None
    infeasible: int


Progress = Callable[[SearchProgress], None]
"""Callback after each evaluation."""


class SearchResult(NamedTuple):
    """Result of a search.

    Attributes:
        front: estimates of the points on the estimated front.
        hypervolume: hypervolume of their estimated means.
        generations: number of generations, including the final ones with leaders only.
        evaluations: number of evaluations, without those of the screening.
        infeasible: number of infeasible evaluations among them.
        replayed: number of evaluations that were in the archive already.
        flights: number of flights, without those of the screening.
        screened: number of flights of the screening.
        seconds: wall time of this session, s.
        complete: whether the budget is spent; False if the search was stopped.
    """

    front: list[Estimate]
    hypervolume: float
    generations: int
    evaluations: int
    infeasible: int
    replayed: int
    flights: int
    screened: int
    seconds: float
    complete: bool


def search(
    run: RunDirectory,
    executor: Executor,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
    *,
    screening: Executor | None = None,
) -> SearchResult:
    """Search until the budget is spent; resume from the archive if it holds evaluations.

    The search is deterministic in the configuration's seed. A resumed search requests the same points again, reads
    archived evaluations instead of repeating them, and ends with the result of an uninterrupted search.

    Args:
        run: run directory with the configuration and the archive.
        executor: evaluator of the configuration's `job`.
        progress: called after each evaluation.
        stop: called after each evaluation; the search stops, and can be resumed, when it returns True.
        screening: evaluator of the configuration's `screening_job`, if there is one.

    Raises:
        SearchError: the archive belongs to another search or cannot be written, or another command uses the directory.
    """
    with run.locked():
        run.repair()
        session = _Session(run, executor, screening, progress, stop)
        allocator = make_allocator(run.configuration)
        complete = False
        with contextlib.suppress(_SearchStopped):
            while not (stop and stop()):
                batch = allocator.ask(session.screen if screening else None)
                if batch is None:
                    complete = True
                    break
                allocator.tell(session.evaluate(batch))
                session.hypervolume = allocator.hypervolume()
        return session.result(complete=complete)


def make_allocator(configuration: Configuration) -> BudgetAllocator:
    """Budget allocator of a configuration; deterministic in its seed."""
    settings = configuration.settings
    flight_seeds, algorithm_seed, screen_seeds = np.random.SeedSequence(settings.seed).spawn(3)
    objectives, dimensions = len(configuration.maximised.names), len(configuration.bounds.spec.parameters)
    policy = noise_policy(settings.noise, settings.population)
    return BudgetAllocator(
        make_algorithm(
            settings.algorithm,
            dimensions,
            objectives,
            settings.population,
            int(algorithm_seed.generate_state(1)[0]),
            offspring_per_slot=policy.offspring_per_slot,
            first_offspring_per_slot=policy.offspring_per_slot if settings.screen else 1,
            unbounded=settings.unbounded,
            start=configuration.start_units(),
        ),
        policy,
        population=settings.population,
        dimensions=dimensions,
        objectives=objectives,
        seeds=settings.seeds,
        budget=settings.budget,
        rng=np.random.default_rng(flight_seeds),
        screen_rng=np.random.default_rng(screen_seeds) if settings.screen else None,
    )


class _SearchStopped(Exception):  # noqa: N818 - not an error
    """Raised when `stop` returns True."""


class _Session:
    """Evaluation, archiving and counting in one session of a search."""

    def __init__(
        self,
        run: RunDirectory,
        executor: Executor,
        screening: Executor | None,
        progress: Progress | None,
        stop: Callable[[], bool] | None,
    ) -> None:
        self._run = run
        self._progress = progress
        self._stop = stop
        self._evaluated = _ArchivedEvaluator(run, executor)
        self._screened = _ArchivedEvaluator(run.screening, screening) if run.screening and screening else None
        self._generation = 0
        self.hypervolume: float | None = None
        self._began = time.monotonic()

    def evaluate(self, batch: EvaluationBatch) -> NDArray[np.float64]:
        """Objectives (n, S, K) of a generation, evaluated or read from the archive.

        Raises:
            _SearchStopped: the search was stopped before the end of the generation.
        """
        values = self._values(self._evaluated, batch)
        self._generation += 1
        return values

    def screen(self, batch: EvaluationBatch) -> NDArray[np.float64]:
        """The same for the screening on point masses."""
        assert self._screened is not None  # for the type checker: a search that screens has an executor for it
        return self._values(self._screened, batch)

    def result(self, *, complete: bool) -> SearchResult:
        configuration, source = self._run.configuration, self._evaluated
        # In the order of their numbers, because the order of completion varies.
        evaluations = sorted(source.evaluations, key=lambda evaluation: evaluation.number)
        front = estimated_front(evaluations, configuration.objectives, configuration.maximised)
        return SearchResult(
            front=front,
            hypervolume=hypervolume([estimate.mean for estimate in front]) if front else 0.0,
            generations=self._generation,
            evaluations=len(evaluations),
            infeasible=source.infeasible,
            replayed=source.replayed,
            flights=source.flights,
            screened=self._screened.flights if self._screened else 0,
            seconds=time.monotonic() - self._began,
            complete=complete,
        )

    def _values(self, source: _ArchivedEvaluator, batch: EvaluationBatch) -> NDArray[np.float64]:
        first = len(source.evaluations)
        points = self._run.configuration.bounds.from_unit(batch.points)
        pairs = zip(points.tolist(), batch.seeds, strict=True)
        tasks = [
            EvaluationTask(first + i, self._run.configuration.bounds.params(point), seeds)
            for i, (point, seeds) in enumerate(pairs)
        ]
        for _ in source.evaluate(tasks, self._generation, self._run.configuration):
            if self._progress:
                self._progress(self._current_progress())
            if self._stop and self._stop():
                raise _SearchStopped
        generation = sorted(source.evaluations[first:], key=lambda evaluation: evaluation.number)
        objectives = self._run.configuration.maximised
        return np.array([objectives.of_columns(evaluation.fitness) for evaluation in generation])

    def _current_progress(self) -> SearchProgress:
        sources = [source for source in (self._evaluated, self._screened) if source]
        done = sum(len(source.evaluations) for source in sources)
        flights, budget = self._evaluated.flights, self._run.configuration.settings.budget
        rate = (done - sum(source.replayed for source in sources)) / max(time.monotonic() - self._began, 1e-9)
        return SearchProgress(
            generation=self._generation,
            evaluations=done,
            flights=flights,
            screened=self._screened.flights if self._screened else 0,
            budget=budget,
            hypervolume=self.hypervolume,
            rate=rate,
            seconds_left=(budget - flights) * done / flights / rate if flights else None,
            infeasible=self._evaluated.infeasible,
        )


class _ArchivedEvaluator:
    """Evaluator that reads known tasks from an archive, and evaluates and archives the others.

    Attributes:
        evaluations: evaluations so far, in the order of completion.
        flights: number of their flights.
        infeasible: number of infeasible evaluations among them.
        replayed: number of them that were read from the archive.
    """

    def __init__(self, archive: Archive, executor: Executor) -> None:
        self._archive = archive
        self._executor = executor
        self._archived = {entry.evaluation.number: entry for entry in archive.entries()}
        self.evaluations: list[Evaluation] = []
        self.flights = self.infeasible = self.replayed = 0

    def evaluate(
        self, tasks: list[EvaluationTask], generation: int, configuration: Configuration
    ) -> Iterator[Evaluation]:
        """Read known tasks from the archive, evaluate and archive the others, and yield the new evaluations."""
        for task in tasks:
            if task.number in self._archived:
                self._count(self._recall(task, generation, configuration))
                self.replayed += 1
        for evaluation in self._executor.evaluate([task for task in tasks if task.number not in self._archived]):
            self._archive.append(evaluation, generation)
            self._count(evaluation)
            yield evaluation

    def _count(self, evaluation: Evaluation) -> None:
        self.evaluations.append(evaluation)
        self.flights += len(evaluation.seeds)
        self.infeasible += evaluation.outcome != OK

    def _recall(self, task: EvaluationTask, generation: int, configuration: Configuration) -> Evaluation:
        """Evaluation of a task from the archive.

        Raises:
            SearchError: the archive has another task under this number.
        """
        entry = self._archived[task.number]
        found = entry.evaluation
        if (found.params, found.seeds, entry.generation) == (task.params, task.seeds, generation):
            return found
        then, now = configuration.versions, installed_versions()
        changed = [f"{name} was {then.get(name)}, is {now[name]}" for name in now if then.get(name) != now[name]]
        why = "; ".join(changed) or "its configuration was changed"
        where = f"archive {self._archive.path}: evaluation {task.number}"
        raise SearchError(f"{where} is not the one that this search requests: {why}")


def open_executors(
    configuration: Configuration, workers: int, scheduler: str | None, resources: contextlib.ExitStack
) -> tuple[Executor, Executor | None]:
    """Open the executor of a search, and that of its screening if there is one; `resources` closes them.

    Raises:
        MoflockError: no worker can be started or reached.
    """
    main, screening = (
        resources.enter_context(make_executor(job, workers, scheduler)) if job else None
        for job in (configuration.job, configuration.screening_job)
    )
    assert main is not None  # for the type checker
    return main, screening
