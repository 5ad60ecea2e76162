"""How a search spends its flights: which points fly on which seeds, and how much a few noisy flights are believed.

A flight's objectives depend on its seed: the spread over seeds is as large as the differences between good points. The
best of many single flights is then mostly lucky. A point is therefore judged by its own flights and by those of its
neighbours (`regression`), which also tells, of many points that were bred, those worth flying; the leaders so far fly
again in each generation; and the last flights go to the leaders alone.

A seed by itself makes half of the spread of F_1 and a fifth of that of F_2, for all points alike. Flown on one common
seed, a generation's points would be lucky together, and neighbours would not tell. So each evaluation has seeds of its
own ("refly"), unless common random numbers are asked for: for each generation ("common"), or for all ("fixed", the
paper's way), where single flights are compared as they are.

A search of rigid bodies may be screened: what was bred, and the leaders, fly on a cheaper model, and what that model
lets believe is what is expected of a body, until bodies teach otherwise.
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
    """What is to be flown next: each point on each seed.

    Attributes:
        points: (n, D), unit cube.
        seeds: (n, S), those of each.
    """

    points: NDArray[np.float64]
    seeds: tuple[tuple[int, ...], ...]


Screen = Callable[[EvaluationBatch], NDArray[np.float64]]
"""Flies trials on a cheaper model and gives their objectives (n, S, K)."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class NoisePolicy:
    """What is done about noise.

    Attributes:
        seeds: whose own they are: the "search"'s, each "generation"'s, or each "evaluation"'s.
        leaders: how many of the best points fly again in each generation.
        finals: share of the flights that is kept for the leaders at the end.
        offspring_per_slot: points that are bred for one that flies, the most promising.
    """

    seeds: str
    leaders: int
    finals: float
    offspring_per_slot: int


def noise_policy(name: str, population: int) -> NoisePolicy:
    """The policy of a name: "fixed", "common" or "refly"."""
    if name == "fixed":
        return NoisePolicy(seeds="search", leaders=0, finals=0.0, offspring_per_slot=1)
    whose = "generation" if name == "common" else "evaluation"
    return NoisePolicy(seeds=whose, leaders=max(population // 10, 2), finals=0.15, offspring_per_slot=4)


class BudgetAllocator:
    """Asks an algorithm for points, adds those that fly again, and remembers what all have reached.

    Args:
        algorithm: breeds points.
        policy: what is done about noise.
        population: points that it breeds at a time.
        dimensions: D, parameters of a point.
        objectives: K.
        seeds: flights per point and generation, S.
        budget: flights.
        rng: of the flights' seeds.
        screen_rng: of the seeds of flights on a cheaper model; None if there is none.
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
        self._kept = min(int(policy.finals * budget), budget - population * seeds)  # a first generation must fly
        self._rng = rng
        self._flights = seeds
        self._seeds = _draw_seeds(rng, seeds)
        self._asked = EvaluationBatch(np.empty((0, dimensions)), ())
        self._breeding = True
        self._population = population
        self._screen_rng = screen_rng
        self._screened = EvaluationHistory(dimensions, objectives)
        self._memory = EvaluationHistory(dimensions, objectives, self._screened)

    def ask(self, screen: Screen | None = None) -> EvaluationBatch | None:
        """What to fly next; None when the budget does not allow more.

        Args:
            screen: the cheaper model, if the plan was given seeds for it. All that was bred, and the leaders, fly on it
                first, which the budget does not count.
        """
        leaders = self._memory.leaders(self._policy.leaders)
        if self._breeding and self._affordable(self._left - self._kept) >= self._population + len(leaders):
            asked = self._algorithm.ask(lambda offspring: self._predict(offspring, leaders, screen))
            points = np.concatenate([asked, leaders])
        else:
            self._breeding = False
            points = self._finalists(leaders)
        if not len(points):
            return None
        self._asked = EvaluationBatch(points, self._seeds_of(len(points)))
        self._left -= len(points) * self._flights
        return self._asked

    def tell(self, values: NDArray[np.float64]) -> None:
        """What came of the trials last asked for.

        Args:
            values: (n, S, K), objectives of each flight, to be maximised.
        """
        if not np.isfinite(values).all():
            raise ValueError("an objective is not finite; an infeasible flight has the worst value instead")
        self._memory.add(self._asked.points, values)
        if self._breeding:
            leaders = self._memory.leaders(self._policy.leaders)
            self._algorithm.tell(self._memory.judge, leaders)

    def hypervolume(self) -> float:
        """Of the front, as the search believes it to be by now."""
        return hypervolume(self._memory.believed)

    def _predict(
        self, offspring: NDArray[np.float64], leaders: NDArray[np.float64], screen: Screen | None
    ) -> Prediction | None:
        if screen is not None and self._screen_rng is not None:
            points = np.concatenate([offspring, leaders])
            seeds = tuple(_draw_seeds(self._screen_rng, self._flights) for _ in points)
            self._screened.add(points, screen(EvaluationBatch(points, seeds)))
            self._memory.learn()
        return self._memory.predict(offspring)

    def _finalists(self, leaders: NDArray[np.float64]) -> NDArray[np.float64]:
        """The leaders, and once what the algorithm would like to see flown, as far as the budget goes."""
        if not self._policy.leaders:
            return leaders
        extra_candidates = self._memory.unknown(self._algorithm.extra_candidates())
        return np.concatenate([extra_candidates, leaders])[: self._affordable(self._left)]

    def _affordable(self, flights: int) -> int:
        return flights // self._flights

    def _seeds_of(self, points: int) -> tuple[tuple[int, ...], ...]:
        """Seeds (points, S) of the next trials."""
        if self._policy.seeds == "evaluation":
            return tuple(_draw_seeds(self._rng, self._flights) for _ in range(points))
        if self._policy.seeds == "generation":
            self._seeds = _draw_seeds(self._rng, self._flights)
        return (self._seeds,) * points


class EvaluationHistory:
    """All points that flew, sums over their flights, and what is believed of them.

    Args:
        dimensions: D, parameters of a point.
        objectives: K.
        low_fidelity: of flights on a cheaper model, which help to tell what to expect.

    Attributes:
        believed: (n, K), objectives, in the order in which the points first flew.
    """

    def __init__(self, dimensions: int, objectives: int, low_fidelity: EvaluationHistory | None = None) -> None:
        self._dimensions = dimensions
        self._low_fidelity = low_fidelity
        self._row: dict[bytes, int] = {}
        none = np.empty((0, objectives))
        self._flights = Flights(np.empty((0, dimensions)), np.empty(0), none, none)
        self._process: GaussianProcess | None = None
        self.believed = np.empty((0, objectives))

    def add(self, points: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        """Remember flights: points (n, D) and their values (n, S, K)."""
        new = self.unknown(points)
        self._row.update((point.tobytes(), len(self._row)) for point in new)
        room = np.zeros((len(new), values.shape[2]))
        added = Flights(new, np.zeros(len(new)), room, room)
        self._flights = Flights(*(np.concatenate(pair) for pair in zip(self._flights, added, strict=True)))
        rows = self._rows(points)
        np.add.at(self._flights.number, rows, values.shape[1])
        np.add.at(self._flights.total, rows, values.sum(axis=1))
        np.add.at(self._flights.squares, rows, (values**2).sum(axis=1))
        self.learn()

    def learn(self) -> None:
        """Think again about what has flown: something new may be known of it, or of the cheaper model."""
        if self._row:
            low_fidelity = self._low_fidelity._process if self._low_fidelity else None
            self._process = GaussianProcess(self._flights, self._process, low_fidelity)
            self.believed = self._process.mean()

    def predict(self, points: NDArray[np.float64]) -> Prediction | None:
        """What is to be expected of points (m, D) that have not flown; None while nothing is known of the noise.

        Until then the cheaper model's word is taken, which these points have flown on, if there is one.
        """
        if self._process is not None and self._process.noisy:
            return self._process.predict(points)
        if self._low_fidelity is None or not self._low_fidelity._row:
            return None
        mean = self._low_fidelity.judge(points)
        return Prediction(mean, np.zeros_like(mean))

    def unknown(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Those of the points (n, D) that have not flown, each once."""
        new = {point.tobytes(): point for point in points if point.tobytes() not in self._row}
        return np.array(list(new.values())).reshape(-1, self._dimensions)

    def judge(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """What is believed of points (n, D) that flew: (n, K)."""
        return self.believed[self._rows(points)]

    def leaders(self, count: int) -> NDArray[np.float64]:
        """The best `count` points: by non-dominated fronts of what is believed, and those that flew least first."""
        from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting  # noqa: PLC0415

        count = min(count, len(self._row))
        if not count:
            return np.empty((0, self._dimensions))
        chosen: list[int] = []
        for front in NonDominatedSorting().do(-self.believed, n_stop_if_ranked=count):
            least_flown = front[np.argsort(self._flights.number[front], kind="stable")]
            chosen.extend(least_flown[: count - len(chosen)].tolist())
        return self._flights.points[chosen]

    def _rows(self, points: NDArray[np.float64]) -> list[int]:
        return [self._row[point.tobytes()] for point in points]


def _draw_seeds(rng: np.random.Generator, count: int) -> tuple[int, ...]:
    return tuple(rng.integers(1, 2**31, size=count).tolist())
