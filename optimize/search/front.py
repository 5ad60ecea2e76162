"""Re-evaluation of a front on fresh seeds, its knee, and the choice of a point.

A search selects the points that were best on its own seeds, so its own estimate of the front is biased upwards.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.policies.registry import POLICIES, make_params, values_of
from moflock_mj.errors import PointError, SearchError
from moflock_mj.parameters.points import find_policy
from moflock_mj.scenario.scenario import Scenario
from optimize.analysis.statistics import half_width
from optimize.evaluation.batch import ProgressCallback, evaluate_batch
from optimize.evaluation.evaluation import OK, Evaluation
from optimize.evaluation.interface import Executor
from optimize.evaluation.objectives import FITNESS_NAMES, Objectives
from optimize.search.estimates import CAUTION, estimates, hypervolume, non_dominated

SEEDS = 100
"""Number of fresh seeds for the re-evaluation of a front."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ReevaluatedFront:
    """Points of a search, flown again on fresh seeds.

    Attributes:
        objectives: the K objectives.
        scenario: scenario of the flights.
        dynamics: "point_mass" or "rigid_body".
        policy: name of the policy.
        seeds: (S,), the same for all points; not used by the search.
        points: (n, D).
        fitness: (n, S, 6), or (n, S, 7) with coverage.
        failed: (n,), number of failed flights, whose fitness counts as 0.
        origin: origin of the points, as JSON values, for the provenance of a chosen point.
    """

    objectives: Objectives
    scenario: Scenario
    dynamics: str
    policy: str
    seeds: tuple[int, ...]
    points: NDArray[np.float64]
    fitness: NDArray[np.float64]
    failed: NDArray[np.int64]
    origin: dict[str, Any]

    def params(self, number: int) -> NamedTuple:
        """Point as the parameter type of its policy."""
        return make_params(POLICIES[self.policy], self.points[number].tolist())

    @functools.cached_property
    def values(self) -> NDArray[np.float64]:
        """(n, S, K), objectives of each flight."""
        return self.objectives.of_columns(self.fitness)

    @functools.cached_property
    def mean(self) -> NDArray[np.float64]:
        """(n, K), means of the objectives over the seeds."""
        return np.asarray(self.values.mean(axis=1))

    @functools.cached_property
    def deviation(self) -> NDArray[np.float64]:
        """(n, K), standard deviation from flight to flight."""
        return np.asarray(self.values.std(axis=1, ddof=1))

    @functools.cached_property
    def half_width(self) -> NDArray[np.float64]:
        """(n, K), half width of the mean's 95 % confidence interval (Student's t)."""
        return half_width(self.values, axis=1)

    @functools.cached_property
    def remaining(self) -> NDArray[np.int64]:
        """Indices of the points that are not dominated in the mean, by decreasing first objective."""
        numbers = np.flatnonzero(non_dominated(self.mean))
        return np.asarray(numbers[np.argsort(-self.mean[numbers, 0], kind="stable")])

    @property
    def hypervolume(self) -> float:
        """Hypervolume of the means; the origin is the reference."""
        return hypervolume(self.mean)

    @property
    def knee(self) -> int:
        """Index of the point at the knee."""
        return int(self.remaining[knee(self.mean[self.remaining])])

    def best(self, objective: int) -> int:
        """Index of the point that is best in one objective: 0 corresponds to the paper's A, 1 to its B."""
        return int(np.argmax(self.mean[:, objective]))

    def to_json(self) -> str:
        """JSON text that `load_front` reads."""
        content = {
            "objectives": json.loads(self.objectives.to_json()),
            "scenario": self.scenario.to_dict(),
            "dynamics": self.dynamics,
            "policy": self.policy,
            "seeds": self.seeds,
            "points": self.points.tolist(),
            "fitness": self.fitness.tolist(),
            "failed": self.failed.tolist(),
            "origin": self.origin,
        }
        return json.dumps(content) + "\n"


def candidates(evaluations: Sequence[Evaluation], objectives: Objectives, most: int = 50) -> NDArray[np.float64]:
    """Points (n, D) of a search for the re-evaluation, at most `most`, front by front.

    Points are ranked by their estimated means less CAUTION standard errors, which ranks points with few flights lower.
    """
    known = estimates((flown for flown in evaluations if flown.outcome == OK), objectives)
    if not known:
        return np.empty((0, 0))
    ranked = np.array([estimate.mean - CAUTION * estimate.std_error for estimate in known])
    left = np.arange(len(known))
    chosen: list[int] = []
    while left.size and len(chosen) < most:
        leading = non_dominated(ranked[left])
        front = left[leading][np.argsort(ranked[left[leading], 0])]
        free = most - len(chosen)
        if front.size > free:  # keep the ends, and points between them that are as evenly spread as possible
            front = front[np.linspace(0, front.size - 1, free).round().astype(int)]
        chosen += front.tolist()
        left = left[~leading]
    return np.array([list(values_of(known[number].params).values()) for number in chosen], np.float64)


def fly_front(
    points: NDArray[np.float64],
    executor: Executor,
    *,
    objectives: Objectives,
    scenario: Scenario,
    dynamics: str,
    policy: str,
    seeds: Sequence[int],
    origin: dict[str, Any] | None = None,
    progress: ProgressCallback | None = None,
) -> ReevaluatedFront:
    """Fly points on fresh seeds, the same for all.

    Args:
        points: (n, D), the points.
        executor: evaluator for this scenario and these dynamics.
        objectives: objectives of the search.
        scenario: scenario of the flights.
        dynamics: "point_mass" or "rigid_body".
        policy: name of the points' policy.
        seeds: (S,), seeds of each point; the caller makes sure that the search has not used them.
        origin: see `ReevaluatedFront`.
        progress: called after each flight.

    Raises:
        SearchError: there are no points, or fewer than two seeds.
    """
    if not len(points):
        raise SearchError("front: it has no points; it must have at least 1")
    if len(seeds) < 2:
        raise SearchError(f"seeds: {len(seeds)} is too few: it must be at least 2")
    params = [make_params(POLICIES[policy], point) for point in np.asarray(points).tolist()]
    flown = evaluate_batch(executor, params, [seeds] * len(points), progress)
    return ReevaluatedFront(
        objectives=objectives,
        scenario=scenario,
        dynamics=dynamics,
        policy=policy,
        seeds=tuple(seeds),
        points=np.asarray(points, np.float64),
        fitness=flown.fitness,
        failed=flown.failed,
        origin=origin or {},
    )


def load_front(path: str | Path) -> ReevaluatedFront:
    """Read a front that `to_json` wrote.

    Raises:
        SearchError: the file cannot be read or holds no front.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        return ReevaluatedFront(
            objectives=Objectives.from_json(json.dumps(content["objectives"])),
            scenario=Scenario.from_dict(content["scenario"]),
            dynamics=content["dynamics"],
            policy=find_policy(content["policy"]).name,
            seeds=tuple(content["seeds"]),
            points=np.array(content["points"], np.float64),
            fitness=np.array(content["fitness"], np.float64),
            failed=np.array(content["failed"], np.int64),
            origin=content["origin"],
        )
    except OSError as problem:
        raise SearchError(f"front {path}: {problem.strerror}") from None
    except (ValueError, KeyError, TypeError, PointError) as problem:
        raise SearchError(f"front {path}: not a front: {problem}") from None


def knee(values: ArrayLike) -> int:
    """Index of the knee of a front with objectives (n, K).

    Each objective is scaled to 0 at its worst and 1 at its best on the front. The knee is the point farthest above the
    plane through the extremes, which is the one with the largest sum (Das, On characterizing the "knee" of the Pareto
    curve based on normal-boundary intersection, Structural Optimization 18, 1999).
    """
    v = np.asarray(values, np.float64)
    width = np.ptp(v, axis=0)
    scaled = (v - v.min(axis=0)) / np.where(width > 0, width, 1.0)
    return int(np.argmax(scaled.sum(axis=1)))


def choose(front: ReevaluatedFront, *, weights: Sequence[float] | None = None, min_f1: float | None = None) -> int:
    """Index of a point of the front chosen by weights or by a constraint; the knee if neither is given.

    Args:
        front: the front on fresh seeds.
        weights: (K,), weights of the objectives; the point with the largest weighted sum of means is chosen.
        min_f1: least mean of the first objective; the point with the best second objective is chosen.

    Raises:
        SearchError: both are given, the weights are invalid, or no point reaches `min_f1`.
    """
    names, mean = front.objectives.names, front.mean[front.remaining]
    if weights is not None and min_f1 is not None:
        raise SearchError("pick: weights and min_f1 are both given; it must be one of them")
    if weights is not None:
        w = np.asarray(weights, np.float64)
        if w.shape != (len(names),) or not np.isfinite(w).all() or (w < 0).any() or not w.any():
            raise SearchError(f"weights: {tuple(weights)} it must be {len(names)} numbers of at least 0, not all 0")
        return int(front.remaining[np.argmax(mean @ w)])
    if min_f1 is None:
        return front.knee
    return best_with(front, 1, kept=0, least=min_f1)


def best_with(front: ReevaluatedFront, wanted: int, *, kept: int, least: float) -> int:
    """Index of the point with the best objective `wanted` among those whose mean objective `kept` is at least `least`.

    Raises:
        SearchError: no point reaches `least`.
    """
    names, mean = front.objectives.names, front.mean[front.remaining]
    if len(names) < 2:
        raise SearchError(f"front: it has {len(names)} objective; it must have at least 2")
    reach = mean[:, kept] >= least
    if not reach.any():
        most = mean[:, kept].max()
        raise SearchError(
            f"least {names[kept]}: {least:g} is out of bounds: it must be at most {most:.3f} on this front"
        )
    return int(front.remaining[np.argmax(np.where(reach, mean[:, wanted], -np.inf))])


def point_json(front: ReevaluatedFront, number: int, *, rule: str) -> str:
    """JSON text of a point of the front with its provenance, as `moflock_mj.parameters.points.load_point` reads it.

    Args:
        front: the front on fresh seeds.
        number: index of the point.
        rule: rule by which the point was chosen, in words.
    """
    values = zip(front.objectives.names, front.mean[number], front.deviation[number], strict=True)
    columns = (*FITNESS_NAMES, "coverage")[: front.fitness.shape[-1]]
    fitness = zip(columns, front.fitness[number].mean(axis=0), strict=True)
    half_width = dict(zip(front.objectives.names, front.half_width[number].tolist(), strict=True))
    content = {
        "policy": front.policy,
        "params": values_of(front.params(number)),
        "provenance": {
            "chosen_as": rule,
            "objectives": {name: {"mean": float(m), "std": float(s)} for name, m, s in values},
            "half_width_95": half_width,
            "fitness_mean": {name: float(mean) for name, mean in fitness},
            "flights": len(front.seeds),
            "failed_flights": int(front.failed[number]),
            "seeds": f"{front.seeds[0]} to {front.seeds[-1]}, without those of the search",
            "dynamics": front.dynamics,
            "scenario": _changes(front.scenario),
            **front.origin,
        },
    }
    return json.dumps(content, indent=1) + "\n"


def _changes(scenario: Scenario) -> dict[str, Any]:
    """Fields in which a scenario differs from the paper's."""
    values, defaults = scenario.to_dict(), Scenario().to_dict()
    return {name: value for name, value in values.items() if value != defaults[name]}
