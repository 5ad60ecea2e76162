"""The search: a loop that asks, flies, archives and tells."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.flocking import FlockingParams
from moflock_mj.errors import SearchError
from optimize.algorithms import make_algorithm
from optimize.archive import RunDirectory
from optimize.configuration import Configuration, installed_versions
from optimize.estimates import Estimate, estimated_front, hypervolume
from optimize.evaluation import OK, Evaluation, Task
from optimize.executor import Executor
from optimize.plan import Plan, Trials, noise_policy


class SearchProgress(NamedTuple):
    """How far a search is.

    Attributes:
        generation: the one in flight, from 0.
        evaluations: done, those of the archive included.
        flights: done.
        budget: flights in all.
        hypervolume: of the front so far, as the search itself estimates it; None before the first generation is over.
        rate: evaluations per second since this session began.
        seconds_left: s.
        infeasible: evaluations that could not be flown.
    """

    generation: int
    evaluations: int
    flights: int
    budget: int
    hypervolume: float | None
    rate: float
    seconds_left: float
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
    seconds: float
    complete: bool


def search(
    run: RunDirectory,
    executor: Executor,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
) -> SearchResult:
    """Search until the budget is spent, and go on where the archive ends if the run was begun before.

    Everything follows from the configuration's seed. A search that was killed and is begun again asks for the same
    points; those that the archive has are not flown again, and the result is that of a search never killed.

    Args:
        run: the configuration, and the archive that each evaluation is committed to.
        executor: flies them.
        progress: told after each evaluation.
        stop: asked after each evaluation; the search ends, to be resumed, when it says True.

    Raises:
        SearchError: the archive is not of this search or cannot be written, or another search is running in it.
    """
    with run.locked():
        run.repair()
        session = _Session(run, executor, progress)
        plan = make_plan(run.configuration)
        complete = False
        while not (stop and stop()):
            trials = plan.ask()
            if trials is None:
                complete = True
                break
            values = session.fly(trials, stop)
            if values is None:
                break
            plan.tell(values)
            session.hypervolume = plan.hypervolume()
        return session.result(complete=complete)


def make_plan(configuration: Configuration) -> Plan:
    """How the configured search spends its flights; the same each time."""
    settings = configuration.settings
    flight_seeds, algorithm_seed = np.random.SeedSequence(settings.seed).spawn(2)
    objectives = len(configuration.maximised.names)
    policy = noise_policy(settings.noise, settings.population)
    return Plan(
        make_algorithm(
            settings.algorithm,
            objectives,
            settings.population,
            int(algorithm_seed.generate_state(1)[0]),
            brood=policy.brood,
            unbounded=settings.unbounded,
        ),
        policy,
        population=settings.population,
        objectives=objectives,
        seeds=settings.seeds,
        budget=settings.budget,
        rng=np.random.default_rng(flight_seeds),
    )


class _Session:
    """The part of a search that flies, archives and counts."""

    def __init__(self, run: RunDirectory, executor: Executor, progress: Progress | None) -> None:
        self._run = run
        self._executor = executor
        self._progress = progress
        self._archived = {entry.evaluation.number: entry for entry in run.entries()}
        self._evaluations: list[Evaluation] = []
        """All that were flown or recalled, in the order in which they came."""
        self._generation = 0
        self._flights = self._infeasible = self._replayed = 0
        self.hypervolume: float | None = None
        self._began = time.monotonic()

    def fly(self, trials: Trials, stop: Callable[[], bool] | None) -> NDArray[np.float64] | None:
        """Objectives (n, S, K) of a generation, flown or found in the archive; None if it was stopped."""
        first = len(self._evaluations)
        points = self._run.configuration.bounds.from_unit(trials.points)
        pairs = zip(points.tolist(), trials.seeds, strict=True)
        tasks = [Task(first + i, FlockingParams(*point), seeds) for i, (point, seeds) in enumerate(pairs)]
        for task in tasks:
            if task.number in self._archived:
                self._count(self._recall(task))
                self._replayed += 1
        missing = [task for task in tasks if task.number not in self._archived]
        for evaluation in self._executor.evaluate(missing):
            self._run.append(evaluation, self._generation)
            self._count(evaluation)
            if self._progress:
                self._progress(self._how_far())
            if stop and stop():
                return None
        self._generation += 1
        generation = sorted(self._evaluations[first:], key=lambda evaluation: evaluation.number)
        objectives = self._run.configuration.maximised
        return np.array([objectives.of_columns(evaluation.fitness) for evaluation in generation])

    def _count(self, evaluation: Evaluation) -> None:
        self._evaluations.append(evaluation)
        self._flights += len(evaluation.seeds)
        self._infeasible += evaluation.outcome != OK

    def result(self, *, complete: bool) -> SearchResult:
        configuration = self._run.configuration
        # In the order of their numbers, so that the order of completion changes nothing.
        evaluations = sorted(self._evaluations, key=lambda evaluation: evaluation.number)
        front = estimated_front(evaluations, configuration.objectives, configuration.maximised)
        return SearchResult(
            front=front,
            hypervolume=hypervolume([estimate.mean for estimate in front]) if front else 0.0,
            generations=self._generation,
            evaluations=len(self._evaluations),
            infeasible=self._infeasible,
            replayed=self._replayed,
            flights=self._flights,
            seconds=time.monotonic() - self._began,
            complete=complete,
        )

    def _recall(self, task: Task) -> Evaluation:
        """A task's evaluation from the archive.

        Raises:
            SearchError: the archive has another task under this number.
        """
        entry = self._archived[task.number]
        found = entry.evaluation
        if (found.params, found.seeds, entry.generation) == (task.params, task.seeds, self._generation):
            return found
        then, now = self._run.configuration.versions, installed_versions()
        changed = [f"{name} {then.get(name)} then, {now[name]} now" for name in now if then.get(name) != now[name]]
        why = "; ".join(changed) or "its configuration was changed"
        raise SearchError(f"archive {self._run.path}: evaluation {task.number} is not what this search asks for: {why}")

    def _how_far(self) -> SearchProgress:
        done, budget = len(self._evaluations), self._run.configuration.settings.budget
        rate = (done - self._replayed) / max(time.monotonic() - self._began, 1e-9)
        return SearchProgress(
            generation=self._generation,
            evaluations=done,
            flights=self._flights,
            budget=budget,
            hypervolume=self.hypervolume,
            rate=rate,
            seconds_left=(budget - self._flights) * done / self._flights / rate,
            infeasible=self._infeasible,
        )
