"""Evaluation of one point: a flight on each of its seeds."""

from __future__ import annotations

import dataclasses
import os
import socket
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.policies.registry import DEFAULT_POLICY
from moflock_mj.errors import PointError
from moflock_mj.flight import fly
from moflock_mj.metrics.catalogue import METRICS
from moflock_mj.metrics.tracking import MotionFigures
from moflock_mj.parameters.bounds import policy_bounds
from moflock_mj.parameters.points import check_point
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulation.results import BodyFigures, Flight
from optimize.evaluation.coverage import coverage
from optimize.evaluation.objectives import FITNESS_NAMES

FIGURE_NAMES = (*MotionFigures._fields, *BodyFigures._fields)
"""Columns of an evaluation's figures."""


def figure_columns(figures: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Columns (S,) of figures (S, F), by their names, FIGURE_NAMES."""
    return dict(zip(FIGURE_NAMES, figures.T, strict=True))


OK = "ok"
"""Outcome of a successful evaluation."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Job:
    """Common settings of all evaluations of a search.

    Attributes:
        scenario: scenario of the flights.
        dynamics: "point_mass" or "rigid_body".
        policy: name of the policy.
        coverage: whether the fitness has the coverage as a seventh column.
        timeout: s, limit of the wall time of one evaluation; None for no limit.
        variants: other scenarios that a task may select.
    """

    scenario: Scenario
    dynamics: str
    policy: str = DEFAULT_POLICY
    coverage: bool = False
    timeout: float | None = None
    variants: tuple[Scenario, ...] = ()

    def scenario_of(self, task: EvaluationTask) -> Scenario:
        """Scenario that a task flies."""
        return self.scenario if task.variant is None else self.variants[task.variant]


class EvaluationTask(NamedTuple):
    """A point and the seeds on which to evaluate it.

    Attributes:
        number: number of the evaluation in its search, from 0.
        params: the point.
        seeds: (S,), one flight each.
        variant: index of one of the job's variants; None for the job's own scenario.
    """

    number: int
    params: NamedTuple
    seeds: tuple[int, ...]
    variant: int | None = None


class Evaluation(NamedTuple):
    """Result of a task.

    Attributes:
        number: number of the task.
        params: point of the task.
        seeds: (S,), seeds of the task.
        order_parameters: (S, 6), in the order of OrderParameters; NaN unless the outcome is "ok".
        fitness: (S, 6) in the order of FITNESS_NAMES, or (S, 7) with coverage; 0 (worst) unless the outcome is "ok".
        figures: (S, F) in the order of FIGURE_NAMES; NaN if undefined for point masses or unless the outcome is "ok".
        seconds: s, wall time.
        worker: name of the worker.
        outcome: "ok", or one line with the reason of the failure.
    """

    number: int
    params: NamedTuple
    seeds: tuple[int, ...]
    order_parameters: NDArray[np.float64]
    fitness: NDArray[np.float64]
    figures: NDArray[np.float64]
    seconds: float
    worker: str
    outcome: str


def evaluate(job: Job, task: EvaluationTask) -> Evaluation:
    """Fly a task's point on each of its seeds.

    The evaluation is infeasible if the point is invalid for its policy or a fitness is not finite.

    Raises:
        TimeoutError: the flights exceeded the job's time limit.
        Exception: a flight failed.
    """
    began = time.perf_counter()
    try:
        params = check_point(task.params)
    except PointError as error:
        return infeasible(job, task, str(error))
    scenario = job.scenario_of(task)
    flights = [_fly_in_time(job, scenario, params, seed, began) for seed in task.seeds]
    fitness = np.array([_fitness_row(job, flight) for flight in flights])
    if not np.isfinite(fitness).all():
        return infeasible(job, task, "a fitness is not finite")
    return Evaluation(
        number=task.number,
        params=task.params,
        seeds=task.seeds,
        order_parameters=np.array([flight.order_parameters for flight in flights], np.float64),
        fitness=fitness,
        figures=np.array([_figures_row(flight) for flight in flights]),
        seconds=time.perf_counter() - began,
        worker=worker_name(),
        outcome=OK,
    )


def infeasible(job: Job, task: EvaluationTask, reason: str, seconds: float = 0.0, worker: str = "") -> Evaluation:
    """Evaluation of a failed task: the worst fitness, and the reason in one line."""
    return Evaluation(
        number=task.number,
        params=task.params,
        seeds=task.seeds,
        order_parameters=np.full((len(task.seeds), len(METRICS)), np.nan),
        fitness=np.zeros((len(task.seeds), len(FITNESS_NAMES) + job.coverage)),
        figures=np.full((len(task.seeds), len(FIGURE_NAMES)), np.nan),
        seconds=seconds,
        worker=worker or worker_name(),
        outcome=" ".join(reason.split()) or "failed",
    )


def warm_up(job: Job) -> str:
    """Fly a job's shortest flight, to load and compile all code, and return the worker's name.

    Raises:
        MoflockError: these dynamics cannot fly the scenario.
    """
    scenario = job.scenario.replace(duration=job.scenario.sample_period, warm_up=0.0)
    middle = policy_bounds(job.policy)
    fly(
        middle.params(middle.from_unit(np.full(len(middle.lower), 0.5))),
        scenario=scenario,
        dynamics=job.dynamics,
        seed=0,
        keep_samples=False,
    )
    if job.coverage:
        coverage(np.zeros((1, 1, 3)), scenario.arena)
    return worker_name()


def worker_name() -> str:
    """Name of this process: host name and process number."""
    return f"{socket.gethostname()}:{os.getpid()}"


def _fly_in_time(job: Job, scenario: Scenario, params: NamedTuple, seed: int, began: float) -> Flight:
    def late() -> bool:
        return job.timeout is not None and time.perf_counter() - began > job.timeout

    flight = fly(params, scenario=scenario, dynamics=job.dynamics, seed=seed, keep_samples=job.coverage, stop=late)
    if not flight.complete:
        raise TimeoutError(f"timed out after {job.timeout:g} s")
    return flight


def _fitness_row(job: Job, flight: Flight) -> list[float]:
    row = [float(getattr(flight.fitness, name)) for name in FITNESS_NAMES]
    if job.coverage:
        assert flight.samples is not None  # for the type checker: requested above
        row.append(float(coverage(flight.samples.position, job.scenario.arena)[-1]))
    return row


def _figures_row(flight: Flight) -> list[float]:
    body = flight.body or [np.nan] * len(BodyFigures._fields)
    return [float(value) for value in (*flight.motion, *body)]


SEARCH_STEP = 0.1
"""Time step of point masses in a search, s. A flight takes well under half the time that it takes with the default
step of 0.01 s. Over 40 seeds, the mean objectives of points A, B and the model's optimum differ by no more than their
standard errors."""


def search_scenario(scenario: Scenario, dynamics: str) -> Scenario:
    """Scenario as a search flies it: point masses use SEARCH_STEP unless the scenario sets a step."""
    if dynamics == "point_mass" and scenario.step is None:
        return scenario.replace(step=SEARCH_STEP)
    return scenario
