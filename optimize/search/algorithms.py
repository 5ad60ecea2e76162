"""Search algorithms: adapters of pymoo and pycma with an ask-and-tell interface.

The algorithms work in the unit cube and maximise all objectives. Each has its own random generator and shares no state,
so that the same calls of `ask` and `tell` give the same points.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from moflock_mj.errors import SearchError
from optimize.search.gaussian_process import Prediction

Score = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Function that returns the current estimates of the objectives (n, K) of evaluated points (n, D)."""


Predict = Callable[[NDArray[np.float64]], Prediction | None]
"""Function that predicts the objectives of points (n, D); it returns None as long as no prediction is possible."""

_OPTIMISM = 1.0
"""Standard deviations added to the predicted mean of an offspring when the most promising are selected."""


class Algorithm(Protocol):
    """Source of new points."""

    def ask(self, predict: Predict) -> NDArray[np.float64]:
        """Return new points (n, D), in the unit cube unless the algorithm is unbounded.

        Args:
            predict: predicts the objectives of candidates; optional to use.
        """
        ...

    def tell(self, score: Score, leaders: NDArray[np.float64]) -> None:
        """Update the algorithm with the points of the last `ask`.

        Args:
            score: estimates the objectives of these and all earlier points; the estimates of earlier points may change.
            leaders: (m, D), the best points so far; optional to use.
        """
        ...

    def extra_candidates(self) -> NDArray[np.float64]:
        """Further points (m, D) that are worth a flight at the end of a search; usually none."""
        ...


def make_algorithm(
    name: str,
    dimensions: int,
    objectives: int,
    population: int,
    seed: int,
    *,
    offspring_per_slot: int = 1,
    first_offspring_per_slot: int = 1,
    unbounded: bool = False,
    start: NDArray[np.float64] | None = None,
) -> Algorithm:
    """Create an algorithm by its name.

    Args:
        name: one of ALGORITHMS.
        dimensions: D, number of parameters of a point.
        objectives: K, number of objectives.
        population: points per generation.
        seed: seed of the random generator.
        offspring_per_slot: offspring of a genetic algorithm per evaluated point.
        first_offspring_per_slot: the same in the first generation; more than 1 is useful with screening only.
        unbounded: whether cmaes may leave the unit cube.
        start: (m, D), points of a genetic algorithm's first generation; random points complete it.
    """
    if name == "cmaes":
        return CovarianceAdaptation(dimensions, population, seed, unbounded=unbounded)
    if name == "pso":
        return Swarm(dimensions, objectives, population, seed)
    return Evolution(
        name,
        dimensions,
        objectives,
        population,
        seed,
        offspring_per_slot=offspring_per_slot,
        first_offspring_per_slot=first_offspring_per_slot,
        start=start,
    )


class Evolution:
    """pymoo's genetic algorithms, with SBX (0.9, 15) and polynomial mutation (20).

    Args:
        name: "nsga2" (Deb et al. 2002) or "unsga3" (Seada and Deb 2016).
        dimensions: D, number of parameters of a point.
        objectives: K, number of objectives.
        population: size of the surviving population, and number of points evaluated in a generation.
        seed: seed of the random generator.
        offspring_per_slot: offspring per evaluated point.
        first_offspring_per_slot: the same in the first generation.
        start: (m, D), points of the first generation; random points complete it.
    """

    def __init__(
        self,
        name: str,
        dimensions: int,
        objectives: int,
        population: int,
        seed: int,
        *,
        offspring_per_slot: int,
        first_offspring_per_slot: int,
        start: NDArray[np.float64] | None = None,
    ) -> None:
        from pymoo.algorithms.moo.nsga2 import NSGA2  # noqa: PLC0415 - pymoo takes a second to load
        from pymoo.algorithms.moo.unsga3 import UNSGA3  # noqa: PLC0415
        from pymoo.operators.crossover.sbx import SBX  # noqa: PLC0415
        from pymoo.operators.mutation.pm import PM  # noqa: PLC0415

        self._dimensions = dimensions
        kinds = {"nsga2": NSGA2, "unsga3": UNSGA3}
        more: dict[str, Any] = {"ref_dirs": _even_directions(objectives, population)} if name == "unsga3" else {}
        if first_offspring_per_slot > 1 or start is not None:
            first = np.random.default_rng(seed).random((first_offspring_per_slot * population, dimensions))
            more["sampling"] = first if start is None else np.concatenate([start, first[len(start) :]])
        self._algorithm = kinds[name](
            pop_size=population,
            n_offsprings=offspring_per_slot * population,
            crossover=SBX(prob=0.9, eta=15),
            mutation=PM(eta=20),
            termination=_never(),
            seed=seed,
            **more,
        )
        self._algorithm.setup(_cube(dimensions, objectives))
        self._population = population
        self._offspring: Any = None

    def ask(self, predict: Predict) -> NDArray[np.float64]:
        """See `Algorithm`. If there are more offspring than slots in the population, return the most promising ones."""
        offspring = self._algorithm.ask()
        if offspring is None:
            raise SearchError("algorithm: it finds no new points; the bounds are too narrow")
        expected = predict(offspring.get("X")) if len(offspring) > self._population else None
        selected = (
            _promising(expected, self._population) if expected else np.arange(min(len(offspring), self._population))
        )
        self._offspring = offspring[selected]
        return np.array(self._offspring.get("X"), np.float64)

    def tell(self, score: Score, leaders: NDArray[np.float64]) -> None:
        """See `Algorithm`. Parents get their current estimates; leaders that did not survive are added again."""
        from pymoo.core.population import Population  # noqa: PLC0415

        evaluated = self._offspring
        parents = self._algorithm.pop
        if parents is not None and len(parents):
            parents.set("F", -score(parents.get("X")))
            known = {point.tobytes() for point in np.concatenate([parents.get("X"), evaluated.get("X")])}
            lost = [point for point in leaders if point.tobytes() not in known]
            if lost:
                evaluated = Population.merge(evaluated, Population.new(X=np.array(lost)))
        evaluated.set("F", -score(evaluated.get("X")))
        self._algorithm.tell(infills=evaluated)

    def extra_candidates(self) -> NDArray[np.float64]:
        """See `Algorithm`."""
        return np.empty((0, self._dimensions))


class Swarm:
    """pymoo's adaptive particle swarm (Kennedy and Eberhart 1995), for one objective.

    Args:
        dimensions: D.
        objectives: must be 1.
        population: number of particles.
        seed: seed of the random generator.
    """

    def __init__(self, dimensions: int, objectives: int, population: int, seed: int) -> None:
        from pymoo.algorithms.soo.nonconvex.pso import PSO  # noqa: PLC0415

        self._dimensions = dimensions
        self._algorithm = PSO(pop_size=population, termination=_never(), seed=seed)
        self._algorithm.setup(_cube(dimensions, objectives))
        self._particles: Any = None

    def ask(self, predict: Predict) -> NDArray[np.float64]:  # noqa: ARG002
        """See `Algorithm`."""
        self._particles = self._algorithm.ask()
        return np.array(self._particles.get("X"), np.float64)

    def tell(self, score: Score, leaders: NDArray[np.float64]) -> None:  # noqa: ARG002
        """See `Algorithm`. The particles' own best points get their current estimates."""
        bests = self._algorithm.pop
        if bests is not None and len(bests):
            bests.set("F", -score(bests.get("X")))
        self._particles.set("F", -score(self._particles.get("X")))
        self._algorithm.tell(infills=self._particles)

    def extra_candidates(self) -> NDArray[np.float64]:
        """See `Algorithm`."""
        return np.empty((0, self._dimensions))


class CovarianceAdaptation:
    """pycma's CMA-ES (Hansen and Ostermeier 2001) from the centre of the cube with sigma 0.3, for one objective.

    Args:
        dimensions: D.
        population: points per generation.
        seed: seed of the random generator.
        unbounded: whether points may leave the unit cube.
    """

    def __init__(self, dimensions: int, population: int, seed: int, *, unbounded: bool) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it warns if matplotlib, which is not used here, is missing
            import cma  # noqa: PLC0415

        rng = np.random.default_rng(seed)
        options: dict[str, Any] = {
            "popsize": population,
            "bounds": None if unbounded else [0, 1],
            # Otherwise pycma seeds NumPy's global generator.
            "randn": lambda *shape: rng.standard_normal(shape),
            "seed": np.nan,
            "verbose": -9,
            "maxiter": np.inf,
        }
        self._strategy = cma.CMAEvolutionStrategy(np.full(dimensions, 0.5), 0.3, options)
        self._points: list[NDArray[np.float64]] = []

    def ask(self, predict: Predict) -> NDArray[np.float64]:  # noqa: ARG002
        """See `Algorithm`."""
        self._points = self._strategy.ask()
        return np.array(self._points)

    def tell(self, score: Score, leaders: NDArray[np.float64]) -> None:  # noqa: ARG002
        """See `Algorithm`."""
        self._strategy.tell(self._points, (-score(np.array(self._points))[:, 0]).tolist())

    def extra_candidates(self) -> NDArray[np.float64]:
        """Mean of the search distribution, which CMA-ES itself never evaluates."""
        return np.array([self._strategy.result.xfavorite], np.float64)


def _promising(expected: Prediction, count: int) -> NDArray[np.int64]:
    """Indices of the `count` points with the best optimistic predictions, by fronts and crowding distance."""
    from pymoo.operators.survival.rank_and_crowding.metrics import calc_crowding_distance  # noqa: PLC0415
    from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting  # noqa: PLC0415

    optimistic = expected.mean + _OPTIMISM * expected.deviation
    chosen: list[int] = []
    for front in NonDominatedSorting().do(-optimistic, n_stop_if_ranked=count):
        by_crowding = front[np.argsort(-calc_crowding_distance(-optimistic[front]), kind="stable")]
        chosen.extend(by_crowding[: count - len(chosen)].tolist())
    return np.array(chosen)


def _even_directions(objectives: int, count: int) -> NDArray[np.float64]:
    """Evenly spaced directions (count, K): a Das-Dennis grid for two objectives, else of minimal Riesz energy."""
    from pymoo.util.ref_dirs import get_reference_directions  # noqa: PLC0415

    if objectives == 2:
        return np.asarray(get_reference_directions("das-dennis", 2, n_partitions=count - 1))
    return np.asarray(get_reference_directions("energy", objectives, count, seed=1))


def _cube(dimensions: int, objectives: int) -> Any:
    from pymoo.core.problem import Problem  # noqa: PLC0415

    return Problem(n_var=dimensions, n_obj=objectives, xl=0.0, xu=1.0)


def _never() -> Any:
    from pymoo.core.termination import NoTermination  # noqa: PLC0415

    return NoTermination()
