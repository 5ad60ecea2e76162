"""The front as it holds on fresh seeds: its points flown again, those that remain, its knee, and how to choose one.

A search keeps what looked best on the seeds that it flew, so its own front is too good to be true.
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
"""Fresh seeds on which a front is flown."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ReevaluatedFront:
    """Points of a search, flown again.

    Attributes:
        objectives: what was maximised; K of them.
        scenario: what was flown.
        dynamics: "point_mass" or "rigid_body".
        policy: name of the policy.
        seeds: (S,), not used by the search, the same for all points.
        points: (n, D).
        fitness: (n, S, 6), or (n, S, 7) with coverage.
        failed: (n,), flights that failed and count as 0.
        origin: where the points are from, in words and numbers, for the provenance of a chosen one.
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
        """A point in its policy's own type."""
        return make_params(POLICIES[self.policy], self.points[number].tolist())

    @functools.cached_property
    def values(self) -> NDArray[np.float64]:
        """(n, S, K), the objectives of each flight."""
        return self.objectives.of_columns(self.fitness)

    @functools.cached_property
    def mean(self) -> NDArray[np.float64]:
        """(n, K), the objectives' means over the seeds."""
        return np.asarray(self.values.mean(axis=1))

    @functools.cached_property
    def deviation(self) -> NDArray[np.float64]:
        """(n, K), standard deviation from flight to flight."""
        return np.asarray(self.values.std(axis=1, ddof=1))

    @functools.cached_property
    def half_width(self) -> NDArray[np.float64]:
        """(n, K), half the width of the mean's 95 % confidence interval (Student's t)."""
        return half_width(self.values, axis=1)

    @functools.cached_property
    def remaining(self) -> NDArray[np.int64]:
        """Numbers of the points that no other dominates in the mean, best in the first objective first."""
        numbers = np.flatnonzero(non_dominated(self.mean))
        return np.asarray(numbers[np.argsort(-self.mean[numbers, 0], kind="stable")])

    @property
    def hypervolume(self) -> float:
        """Of the means, from the origin."""
        return hypervolume(self.mean)

    @property
    def knee(self) -> int:
        """Number of the point at the knee."""
        return int(self.remaining[knee(self.mean[self.remaining])])

    def best(self, objective: int) -> int:
        """Number of the point that is best in one objective: 0 gives the paper's A, 1 its B."""
        return int(np.argmax(self.mean[:, objective]))

    def to_json(self) -> str:
        """As `load_front` reads it."""
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
    """The points of a search that deserve to be flown again: (n, D), at most `most`, front by front.

    A point is ranked by its estimated mean less that mean's standard error: of many that flew once the luckiest lead.
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
        room = most - len(chosen)
        if front.size > room:  # keep its ends, and as even a spread between them as there is room for
            front = front[np.linspace(0, front.size - 1, room).round().astype(int)]
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
        points: (n, D).
        executor: flies, in this scenario and with these dynamics.
        objectives: what was maximised.
        scenario: what is flown.
        dynamics: how.
        policy: name of the points' policy.
        seeds: for each point; that the search did not use them is up to the caller.
        origin: see `ReevaluatedFront`.
        progress: called after each flight.

    Raises:
        SearchError: no points, or fewer than two seeds.
    """
    if not len(points):
        raise SearchError("front: it has no points; it must have at least 1")
    if len(seeds) < 2:
        raise SearchError(f"seeds: {len(seeds)} are too few: it must be at least 2")
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
    """Read a front that was written by `to_json`.

    Raises:
        SearchError: the file cannot be read, or is none.
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
    """The point of a front, (n, K), at its knee.

    With each objective scaled to 0 at its worst and 1 at its best on the front, it is the point farthest above the
    plane through the extremes (Das, On characterizing the "knee" of the Pareto curve based on normal-boundary
    intersection, Structural Optimization 18, 1999): that of the largest sum.
    """
    v = np.asarray(values, np.float64)
    width = np.ptp(v, axis=0)
    scaled = (v - v.min(axis=0)) / np.where(width > 0, width, 1.0)
    return int(np.argmax(scaled.sum(axis=1)))


def choose(front: ReevaluatedFront, *, weights: Sequence[float] | None = None, min_f1: float | None = None) -> int:
    """Number of the point of the front that suits best; the knee if nothing is asked.

    Args:
        front: as flown on fresh seeds.
        weights: (K,), of the objectives: the largest weighted sum of the means is chosen.
        min_f1: least mean of the first objective: the best in the second is chosen among those that reach it.

    Raises:
        SearchError: both are given, unusable weights, or a first objective that no point reaches.
    """
    names, mean = front.objectives.names, front.mean[front.remaining]
    if weights is not None and min_f1 is not None:
        raise SearchError("pick: weights and min_f1 are both given; it must be one of them")
    if weights is not None:
        w = np.asarray(weights, np.float64)
        if w.shape != (len(names),) or not np.isfinite(w).all() or (w < 0).any() or not w.any():
            raise SearchError(f"weights: {tuple(weights)} must be {len(names)} numbers of at least 0, not all 0")
        return int(front.remaining[np.argmax(mean @ w)])
    if min_f1 is None:
        return front.knee
    return best_with(front, 1, kept=0, least=min_f1)


def best_with(front: ReevaluatedFront, wanted: int, *, kept: int, least: float) -> int:
    """Number of the point that is best in one objective, `wanted`, of those whose mean of `kept` is at least `least`.

    Raises:
        SearchError: no point reaches that.
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
    """A point of the front as the JSON that `moflock_mj.parameters.points.load_point` reads, with where it is from.

    Args:
        front: as flown.
        number: of the point.
        rule: why this one, in words.
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
    """The fields in which a scenario differs from the paper's."""
    ours, papers = scenario.to_dict(), Scenario().to_dict()
    return {name: value for name, value in ours.items() if value != papers[name]}
