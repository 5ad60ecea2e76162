"""The search: a loop that asks, flies, archives and tells."""

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
    """How far a search is.

    Attributes:
        generation: the one in flight, from 0.
        evaluations: done, those of the archive included.
        flights: done, those on point masses by which a search of bodies is screened left out.
        screened: done of those.
        budget: flights in all.
        hypervolume: of the front so far, as the search itself estimates it; None before the first generation is over.
        rate: evaluations per second since this session began.
        seconds_left: s; None while that cannot be told.
        infeasible: evaluations that could not be flown.
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


class SearchResult(NamedTuple):
    """What a search found.

    Attributes:
        front: the points that are not dominated, by what the search knows: the candidates for a re-evaluation.
        hypervolume: of their estimated means.
        generations: how many were flown, those at the end included.
        evaluations: how many, of which
        infeasible: could not be flown, and
        replayed: were in the archive already.
        flights: how many.
        screened: flights on point masses by which a search of bodies was screened, which all these leave out.
        seconds: s, wall time of this session.
        complete: whether the budget is spent; False if it was stopped.
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
    """Search until the budget is spent, and go on where the archive ends if the run was begun before.

    Everything follows from the configuration's seed. A search that was killed and is begun again asks for the same
    points; those that the archive has are not flown again, and the result is that of a search never killed.

    Args:
        run: the configuration, and the archive that each evaluation is committed to.
        executor: flies them.
        progress: told after each evaluation.
        stop: asked after each evaluation; the search ends, to be resumed, when it says True.
        screening: flies the configuration's `screening_job`, if it has one.

    Raises:
        SearchError: the archive is not of this search or cannot be written, or another search is running in it.
    """
    with run.locked():
        run.repair()
        session = _Session(run, executor, screening, progress, stop)
        plan = make_plan(run.configuration)
        complete = False
        with contextlib.suppress(_Stopped):
            while not (stop and stop()):
                trials = plan.ask(session.screen if screening else None)
                if trials is None:
                    complete = True
                    break
                plan.tell(session.fly(trials))
                session.hypervolume = plan.hypervolume()
        return session.result(complete=complete)


def make_plan(configuration: Configuration) -> BudgetAllocator:
    """How the configured search spends its flights; the same each time."""
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
            first_brood=policy.offspring_per_slot if settings.screen else 1,
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


class _Stopped(Exception):  # noqa: N818 - not an error
    """The search is to end."""


class _Session:
    """The part of a search that flies, archives and counts."""

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
        self._flown = _Flown(run, executor)
        self._screened = _Flown(run.screening, screening) if run.screening and screening else None
        self._generation = 0
        self.hypervolume: float | None = None
        self._began = time.monotonic()

    def fly(self, trials: EvaluationBatch) -> NDArray[np.float64]:
        """Objectives (n, S, K) of a generation, flown or found in the archive.

        Raises:
            _Stopped: before all were flown.
        """
        values = self._values(self._flown, trials)
        self._generation += 1
        return values

    def screen(self, trials: EvaluationBatch) -> NDArray[np.float64]:
        """The same on point masses, before the generation flies."""
        assert self._screened is not None  # for the type checker: a search that screens has an executor for it
        return self._values(self._screened, trials)

    def result(self, *, complete: bool) -> SearchResult:
        configuration, flown = self._run.configuration, self._flown
        # In the order of their numbers, so that the order of completion changes nothing.
        evaluations = sorted(flown.evaluations, key=lambda evaluation: evaluation.number)
        front = estimated_front(evaluations, configuration.objectives, configuration.maximised)
        return SearchResult(
            front=front,
            hypervolume=hypervolume([estimate.mean for estimate in front]) if front else 0.0,
            generations=self._generation,
            evaluations=len(evaluations),
            infeasible=flown.infeasible,
            replayed=flown.replayed,
            flights=flown.flights,
            screened=self._screened.flights if self._screened else 0,
            seconds=time.monotonic() - self._began,
            complete=complete,
        )

    def _values(self, flown: _Flown, trials: EvaluationBatch) -> NDArray[np.float64]:
        first = len(flown.evaluations)
        points = self._run.configuration.bounds.from_unit(trials.points)
        pairs = zip(points.tolist(), trials.seeds, strict=True)
        tasks = [
            EvaluationTask(first + i, self._run.configuration.bounds.params(point), seeds)
            for i, (point, seeds) in enumerate(pairs)
        ]
        for _ in flown.fly(tasks, self._generation, self._run.configuration):
            if self._progress:
                self._progress(self._how_far())
            if self._stop and self._stop():
                raise _Stopped
        generation = sorted(flown.evaluations[first:], key=lambda evaluation: evaluation.number)
        objectives = self._run.configuration.maximised
        return np.array([objectives.of_columns(evaluation.fitness) for evaluation in generation])

    def _how_far(self) -> SearchProgress:
        kinds = [flown for flown in (self._flown, self._screened) if flown]
        done = sum(len(flown.evaluations) for flown in kinds)
        flights, budget = self._flown.flights, self._run.configuration.settings.budget
        rate = (done - sum(flown.replayed for flown in kinds)) / max(time.monotonic() - self._began, 1e-9)
        return SearchProgress(
            generation=self._generation,
            evaluations=done,
            flights=flights,
            screened=self._screened.flights if self._screened else 0,
            budget=budget,
            hypervolume=self.hypervolume,
            rate=rate,
            seconds_left=(budget - flights) * done / flights / rate if flights else None,
            infeasible=self._flown.infeasible,
        )


class _Flown:
    """The evaluations of one archive, flown or recalled, in the order in which they came."""

    def __init__(self, archive: Archive, executor: Executor) -> None:
        self._archive = archive
        self._executor = executor
        self._archived = {entry.evaluation.number: entry for entry in archive.entries()}
        self.evaluations: list[Evaluation] = []
        self.flights = self.infeasible = self.replayed = 0

    def fly(self, tasks: list[EvaluationTask], generation: int, configuration: Configuration) -> Iterator[Evaluation]:
        """Recall the tasks that the archive has, fly and archive the others; gives these as they are done."""
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
        """A task's evaluation from the archive.

        Raises:
            SearchError: the archive has another task under this number.
        """
        entry = self._archived[task.number]
        found = entry.evaluation
        if (found.params, found.seeds, entry.generation) == (task.params, task.seeds, generation):
            return found
        then, now = configuration.versions, installed_versions()
        changed = [f"{name} {then.get(name)} then, {now[name]} now" for name in now if then.get(name) != now[name]]
        why = "; ".join(changed) or "its configuration was changed"
        where = f"archive {self._archive.path}: evaluation {task.number}"
        raise SearchError(f"{where} is not what this search asks for: {why}")


def open_executors(
    configuration: Configuration, workers: int, scheduler: str | None, resources: contextlib.ExitStack
) -> tuple[Executor, Executor | None]:
    """Workers of a search, and those of the point masses by which it is screened, if it is; they end with `resources`.

    Raises:
        MoflockError: none can be had.
    """
    own, screening = (
        resources.enter_context(make_executor(job, workers, scheduler)) if job else None
        for job in (configuration.job, configuration.screening_job)
    )
    assert own is not None  # for the type checker
    return own, screening
