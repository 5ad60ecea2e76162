"""Where new points come from: adapters over pymoo and pycma that are stepped by hand.

Each sees the unit cube and objectives to be maximised, draws its random numbers from a seed of its own, and keeps its
state to itself, so that asking and telling the same gives the same.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from moflock_mj.errors import SearchError
from optimize.search.gaussian_process import Prediction

Judge = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Gives the objectives (n, K), to be maximised, of points (n, D) that have flown, as they are judged by now."""


Predict = Callable[[NDArray[np.float64]], Prediction | None]
"""Gives what is to be expected of points (n, D) that have not flown; None while nothing can be."""

_HOPE = 1.0
"""Standard deviations by which a point that was bred may be better than expected when it is compared with others."""


class Algorithm(Protocol):
    """Breeds points."""

    def ask(self, predict: Predict) -> NDArray[np.float64]:
        """New points (n, D), in the unit cube unless it is unbounded.

        Args:
            predict: of points that it might ask for; may be used.
        """
        ...

    def tell(self, judge: Judge, leaders: NDArray[np.float64]) -> None:
        """Learn from the points last asked for.

        Args:
            judge: of these, and of all that were asked for before, whose judgement may have changed.
            leaders: (m, D), the best of all points so far; may be used.
        """
        ...

    def extra_candidates(self) -> NDArray[np.float64]:
        """Points (m, D) that it would like to be flown though it has not asked for them; mostly none."""
        ...


def make_algorithm(
    name: str,
    dimensions: int,
    objectives: int,
    population: int,
    seed: int,
    *,
    offspring_per_slot: int = 1,
    first_brood: int = 1,
    unbounded: bool = False,
    start: NDArray[np.float64] | None = None,
) -> Algorithm:
    """The algorithm of a name, of ALGORITHMS.

    Args:
        name: see above.
        dimensions: D, parameters of a point.
        objectives: K.
        population: points per generation.
        seed: of its random numbers.
        offspring_per_slot: points that genetic algorithms breed for one that flies.
        first_brood: the same in the first generation, of which nothing is known unless it is screened.
        unbounded: whether it may leave the cube.
        start: (m, D), points that genetic algorithms begin with, besides random ones.
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
        first_brood=first_brood,
        start=start,
    )


class Evolution:
    """pymoo's genetic algorithms, with SBX (0.9, 15) and polynomial mutation (20).

    Args:
        name: "nsga2" (Deb et al. 2002) or "unsga3" (Seada and Deb 2016).
        dimensions: D.
        objectives: K.
        population: points that survive, and that are flown, in a generation.
        seed: of its random numbers.
        offspring_per_slot: points that are bred for one that flies.
        first_brood: the same in the first generation.
        start: (m, D), points of the first generation, which random ones fill up.
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
        first_brood: int,
        start: NDArray[np.float64] | None = None,
    ) -> None:
        from pymoo.algorithms.moo.nsga2 import NSGA2  # noqa: PLC0415 - pymoo takes a second to load
        from pymoo.algorithms.moo.unsga3 import UNSGA3  # noqa: PLC0415
        from pymoo.operators.crossover.sbx import SBX  # noqa: PLC0415
        from pymoo.operators.mutation.pm import PM  # noqa: PLC0415

        self._dimensions = dimensions
        kinds = {"nsga2": NSGA2, "unsga3": UNSGA3}
        more: dict[str, Any] = {"ref_dirs": _even_directions(objectives, population)} if name == "unsga3" else {}
        if first_brood > 1 or start is not None:
            first = np.random.default_rng(seed).random((first_brood * population, dimensions))
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
        """See `Algorithm`. Of a brood that is larger than the population, the most promising points are flown."""
        offspring = self._algorithm.ask()
        if offspring is None:
            raise SearchError("algorithm: it has no new points to offer; the bounds are too narrow")
        expected = predict(offspring.get("X")) if len(offspring) > self._population else None
        chosen = (
            _promising(expected, self._population) if expected else np.arange(min(len(offspring), self._population))
        )
        self._offspring = offspring[chosen]
        return np.array(self._offspring.get("X"), np.float64)

    def tell(self, judge: Judge, leaders: NDArray[np.float64]) -> None:
        """See `Algorithm`. Parents are judged anew; leaders that died out, unlucky in some generation, come back."""
        from pymoo.core.population import Population  # noqa: PLC0415

        told = self._offspring
        parents = self._algorithm.pop
        if parents is not None and len(parents):
            parents.set("F", -judge(parents.get("X")))
            known = {point.tobytes() for point in np.concatenate([parents.get("X"), told.get("X")])}
            lost = [point for point in leaders if point.tobytes() not in known]
            if lost:
                told = Population.merge(told, Population.new(X=np.array(lost)))
        told.set("F", -judge(told.get("X")))
        self._algorithm.tell(infills=told)

    def extra_candidates(self) -> NDArray[np.float64]:
        """See `Algorithm`."""
        return np.empty((0, self._dimensions))


class Swarm:
    """pymoo's adaptive particle swarm (Kennedy and Eberhart 1995), for one objective.

    Args:
        dimensions: D.
        objectives: must be 1.
        population: particles.
        seed: of its random numbers.
    """

    def __init__(self, dimensions: int, objectives: int, population: int, seed: int) -> None:
        from pymoo.algorithms.soo.nonconvex.pso import PSO  # noqa: PLC0415

        self._dimensions = dimensions
        self._algorithm = PSO(pop_size=population, termination=_never(), seed=seed)
        self._algorithm.setup(_cube(dimensions, objectives))
        self._flown: Any = None

    def ask(self, predict: Predict) -> NDArray[np.float64]:  # noqa: ARG002
        """See `Algorithm`."""
        self._flown = self._algorithm.ask()
        return np.array(self._flown.get("X"), np.float64)

    def tell(self, judge: Judge, leaders: NDArray[np.float64]) -> None:  # noqa: ARG002
        """See `Algorithm`. The particles' own bests are judged anew."""
        bests = self._algorithm.pop
        if bests is not None and len(bests):
            bests.set("F", -judge(bests.get("X")))
        self._flown.set("F", -judge(self._flown.get("X")))
        self._algorithm.tell(infills=self._flown)

    def extra_candidates(self) -> NDArray[np.float64]:
        """See `Algorithm`."""
        return np.empty((0, self._dimensions))


class CovarianceAdaptation:
    """pycma's CMA-ES (Hansen and Ostermeier 2001) from the cube's middle with sigma 0.3, for one objective.

    Args:
        dimensions: D.
        population: points per generation.
        seed: of its random numbers.
        unbounded: whether it may leave the cube.
    """

    def __init__(self, dimensions: int, population: int, seed: int, *, unbounded: bool) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # matplotlib is optional to it, and is none of ours
            import cma  # noqa: PLC0415

        rng = np.random.default_rng(seed)
        options: dict[str, Any] = {
            "popsize": population,
            "bounds": None if unbounded else [0, 1],
            # With a seed of its own it would seed NumPy's global generator.
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

    def tell(self, judge: Judge, leaders: NDArray[np.float64]) -> None:  # noqa: ARG002
        """See `Algorithm`."""
        self._strategy.tell(self._points, (-judge(np.array(self._points))[:, 0]).tolist())

    def extra_candidates(self) -> NDArray[np.float64]:
        """The middle of its distribution, which it never flies itself."""
        return np.array([self._strategy.result.xfavorite], np.float64)


def _promising(expected: Prediction, count: int) -> NDArray[np.int64]:
    """Numbers of the `count` points that may turn out best, front by front, the last of which by crowding."""
    from pymoo.operators.survival.rank_and_crowding.metrics import calc_crowding_distance  # noqa: PLC0415
    from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting  # noqa: PLC0415

    hoped = expected.mean + _HOPE * expected.deviation
    chosen: list[int] = []
    for front in NonDominatedSorting().do(-hoped, n_stop_if_ranked=count):
        apart = front[np.argsort(-calc_crowding_distance(-hoped[front]), kind="stable")]
        chosen.extend(apart[: count - len(chosen)].tolist())
    return np.array(chosen)


def _even_directions(objectives: int, count: int) -> NDArray[np.float64]:
    """`count` directions (count, K) that cover the front evenly: a grid for two objectives, else by Riesz's energy."""
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
