"""Allocation of a search's budget of flights under noise.

The objectives of a flight depend on its seed, and their spread over seeds is as large as the differences between good
points. The best of many single flights is therefore mostly the one with the largest noise. For this reason

- a point is scored by a Gaussian process over its own flights and those of its neighbours (`gaussian_process`),
- the same process predicts which of many offspring are worth a flight,
- the leaders (the best points so far) fly again in each generation,
- the last part of the budget is spent on the leaders alone.

The seed alone causes half of the spread of F_1 and a fifth of that of F_2, equally for all points. With one common
seed, the errors of a generation are correlated, and averaging over neighbours does not reduce them. Each evaluation
therefore has its own seeds ("refly"). Common random numbers are optional: new ones for each generation ("common"), or
the same ones for the whole search ("fixed", as in the paper). With "fixed", single flights are compared directly.

A search of rigid bodies may be screened with point masses as the low-fidelity model: the offspring and the leaders fly
as point masses first. These flights predict the rigid-body objectives, and rigid-body flights correct the prediction.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optimize.search.algorithms import Algorithm
from optimize.search.estimates import hypervolume
from optimize.search.gaussian_process import Flights, GaussianProcess, Prediction


class EvaluationBatch(NamedTuple):
    """Points to be flown next, and their seeds.

    Attributes:
        points: (n, D), in the unit cube.
        seeds: (n, S), seeds of each point.
    """

    points: NDArray[np.float64]
    seeds: tuple[tuple[int, ...], ...]


Screen = Callable[[EvaluationBatch], NDArray[np.float64]]
"""Function that flies a batch on the low-fidelity model and returns its objectives (n, S, K)."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class NoisePolicy:
    """Treatment of noise.

    Attributes:
        seeds: what gets new seeds: the whole "search", each "generation", or each "evaluation".
        leaders: number of leaders that fly again in each generation.
        finals: share of the budget that is reserved for the leaders at the end.
        offspring_per_slot: offspring per evaluated point; the most promising one is evaluated.
    """

    seeds: str
    leaders: int
    finals: float
    offspring_per_slot: int


def noise_policy(name: str, population: int) -> NoisePolicy:
    """Noise policy by its name: "fixed", "common" or "refly"."""
    if name == "fixed":
        return NoisePolicy(seeds="search", leaders=0, finals=0.0, offspring_per_slot=1)
    renewal = "generation" if name == "common" else "evaluation"
    return NoisePolicy(seeds=renewal, leaders=max(population // 10, 2), finals=0.15, offspring_per_slot=4)


class BudgetAllocator:
    """Allocator of flights: asks an algorithm for points, adds the leaders, and records all results.

    Args:
        algorithm: source of new points.
        policy: treatment of noise.
        population: number of points per call of the algorithm's `ask`.
        dimensions: D, number of parameters of a point.
        objectives: K, number of objectives.
        seeds: S, flights per point and generation.
        budget: number of flights.
        rng: random generator of the flights' seeds.
        screen_rng: random generator of the seeds of low-fidelity flights; None without screening.
    """

    def __init__(
        self,
        algorithm: Algorithm,
        policy: NoisePolicy,
        *,
        population: int,
        dimensions: int,
        objectives: int,
        seeds: int,
        budget: int,
        rng: np.random.Generator,
        screen_rng: np.random.Generator | None = None,
    ) -> None:
        self._algorithm = algorithm
        self._policy = policy
        self._left = budget
        self._reserve = min(int(policy.finals * budget), budget - population * seeds)  # leaves a first generation
        self._rng = rng
        self._flights = seeds
        self._seeds = _draw_seeds(rng, seeds)
        self._batch = EvaluationBatch(np.empty((0, dimensions)), ())
        self._searching = True
        self._population = population
        self._screen_rng = screen_rng
        self._screened = EvaluationHistory(dimensions, objectives)
        self._history = EvaluationHistory(dimensions, objectives, self._screened)

    def ask(self, screen: Screen | None = None) -> EvaluationBatch | None:
        """Return the next batch; None when the budget is spent.

        Args:
            screen: evaluator of the low-fidelity model, used if `screen_rng` was given. The offspring and the leaders
                fly on it first; these flights do not count towards the budget.
        """
        leaders = self._history.leaders(self._policy.leaders)
        if self._searching and self._affordable(self._left - self._reserve) >= self._population + len(leaders):
            offspring = self._algorithm.ask(lambda candidates: self._predict(candidates, leaders, screen))
            points = np.concatenate([offspring, leaders])
        else:
            self._searching = False
            points = self._finalists(leaders)
        if not len(points):
            return None
        self._batch = EvaluationBatch(points, self._seeds_of(len(points)))
        self._left -= len(points) * self._flights
        return self._batch

    def tell(self, values: NDArray[np.float64]) -> None:
        """Record the results of the last batch.

        Args:
            values: (n, S, K), objectives of each flight, to be maximised.
        """
        if not np.isfinite(values).all():
            raise ValueError("values: an objective is not finite; it must be the worst value for an infeasible flight")
        self._history.add(self._batch.points, values)
        if self._searching:
            leaders = self._history.leaders(self._policy.leaders)
            self._algorithm.tell(self._history.score, leaders)

    def hypervolume(self) -> float:
        """Hypervolume of the current estimates of all points."""
        return hypervolume(self._history.estimates)

    def _predict(
        self, offspring: NDArray[np.float64], leaders: NDArray[np.float64], screen: Screen | None
    ) -> Prediction | None:
        if screen is not None and self._screen_rng is not None:
            points = np.concatenate([offspring, leaders])
            seeds = tuple(_draw_seeds(self._screen_rng, self._flights) for _ in points)
            self._screened.add(points, screen(EvaluationBatch(points, seeds)))
            self._history.learn()
        return self._history.predict(offspring)

    def _finalists(self, leaders: NDArray[np.float64]) -> NDArray[np.float64]:
        """The leaders, preceded once by the algorithm's extra candidates, within the budget."""
        if not self._policy.leaders:
            return leaders
        extra_candidates = self._history.unknown(self._algorithm.extra_candidates())
        return np.concatenate([extra_candidates, leaders])[: self._affordable(self._left)]

    def _affordable(self, flights: int) -> int:
        return flights // self._flights

    def _seeds_of(self, points: int) -> tuple[tuple[int, ...], ...]:
        """Seeds (points, S) of the next batch."""
        if self._policy.seeds == "evaluation":
            return tuple(_draw_seeds(self._rng, self._flights) for _ in range(points))
        if self._policy.seeds == "generation":
            self._seeds = _draw_seeds(self._rng, self._flights)
        return (self._seeds,) * points


class EvaluationHistory:
    """All evaluated points, with the sums over their flights and the estimates of their mean objectives.

    Args:
        dimensions: D, number of parameters of a point.
        objectives: K, number of objectives.
        low_fidelity: history of low-fidelity flights, which improves the predictions; or None.

    Attributes:
        estimates: (n, K), estimated mean objectives, in the order of the points' first flights.
    """

    def __init__(self, dimensions: int, objectives: int, low_fidelity: EvaluationHistory | None = None) -> None:
        self._dimensions = dimensions
        self._low_fidelity = low_fidelity
        self._row: dict[bytes, int] = {}
        none = np.empty((0, objectives))
        self._flights = Flights(np.empty((0, dimensions)), np.empty(0), none, none)
        self._process: GaussianProcess | None = None
        self.estimates = np.empty((0, objectives))

    def add(self, points: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        """Add flights: points (n, D) and their objectives (n, S, K)."""
        new = self.unknown(points)
        self._row.update((point.tobytes(), len(self._row)) for point in new)
        zeros = np.zeros((len(new), values.shape[2]))
        added = Flights(new, np.zeros(len(new)), zeros, zeros)
        self._flights = Flights(*(np.concatenate(pair) for pair in zip(self._flights, added, strict=True)))
        rows = self._rows(points)
        np.add.at(self._flights.number, rows, values.shape[1])
        np.add.at(self._flights.total, rows, values.sum(axis=1))
        np.add.at(self._flights.squares, rows, (values**2).sum(axis=1))
        self.learn()

    def learn(self) -> None:
        """Fit the Gaussian process to all flights so far, and update `estimates`."""
        if self._row:
            low_fidelity = self._low_fidelity._process if self._low_fidelity else None
            self._process = GaussianProcess(self._flights, self._process, low_fidelity)
            self.estimates = self._process.mean()

    def predict(self, points: NDArray[np.float64]) -> Prediction | None:
        """Predict the objectives of points (m, D) that have not flown; None as long as the noise is unknown.

        With a low-fidelity model, on which these points have flown, return its estimates instead of None.
        """
        if self._process is not None and self._process.noisy:
            return self._process.predict(points)
        if self._low_fidelity is None or not self._low_fidelity._row:
            return None
        mean = self._low_fidelity.score(points)
        return Prediction(mean, np.zeros_like(mean))

    def unknown(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (m, D) among the given ones (n, D) that have not flown, without duplicates."""
        new = {point.tobytes(): point for point in points if point.tobytes() not in self._row}
        return np.array(list(new.values())).reshape(-1, self._dimensions)

    def score(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Estimated mean objectives (n, K) of points (n, D) that have flown."""
        return self.estimates[self._rows(points)]

    def leaders(self, count: int) -> NDArray[np.float64]:
        """The best `count` points by the fronts of their estimates; in a front, those with the fewest flights first."""
        from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting  # noqa: PLC0415

        count = min(count, len(self._row))
        if not count:
            return np.empty((0, self._dimensions))
        chosen: list[int] = []
        for front in NonDominatedSorting().do(-self.estimates, n_stop_if_ranked=count):
            fewest_first = front[np.argsort(self._flights.number[front], kind="stable")]
            chosen.extend(fewest_first[: count - len(chosen)].tolist())
        return self._flights.points[chosen]

    def _rows(self, points: NDArray[np.float64]) -> list[int]:
        return [self._row[point.tobytes()] for point in points]


def _draw_seeds(rng: np.random.Generator, count: int) -> tuple[int, ...]:
    return tuple(rng.integers(1, 2**31, size=count).tolist())
