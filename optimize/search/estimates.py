"""What an archive knows about its points: mean objectives, how sure they are, and which of them make the front."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.policies.registry import values_of
from optimize.evaluation.evaluation import Evaluation
from optimize.evaluation.objectives import Objectives
from optimize.search.gaussian_process import Flights, GaussianProcess

CAUTION = 1.0
"""Standard errors that are taken off a mean before points are compared: one lucky flight makes no front."""


class Estimate(NamedTuple):
    """A point as its flights, and those of its neighbours, judge it.

    Attributes:
        params: the point.
        mean: (K,), what is believed of its mean objectives; see `regression`. Where no point flew twice, so that
            nothing is known of the noise, the mean over its own flights.
        std_error: (K,), standard deviation of that belief.
        flights: how many it flew.
    """

    params: NamedTuple
    mean: NDArray[np.float64]
    std_error: NDArray[np.float64]
    flights: int


def estimates(evaluations: Iterable[Evaluation], objectives: Objectives) -> list[Estimate]:
    """One estimate per point, in the order in which the points first flew."""
    flights: dict[NamedTuple, list[NDArray[np.float64]]] = {}
    for evaluation in evaluations:
        flights.setdefault(evaluation.params, []).extend(objectives.of_columns(evaluation.fitness))
    if not flights:
        return []
    flown = Flights(
        points=np.array([list(values_of(params).values()) for params in flights]),
        number=np.array([len(rows) for rows in flights.values()], np.float64),
        total=np.array([np.sum(rows, axis=0) for rows in flights.values()]),
        squares=np.array([np.sum(np.square(rows), axis=0) for rows in flights.values()]),
    )
    believed = GaussianProcess(flown).prediction()
    return [
        Estimate(params, mean, error, int(number))
        for params, mean, error, number in zip(flights, believed.mean, believed.deviation, flown.number, strict=True)
    ]


def estimated_front(
    evaluations: Iterable[Evaluation], objectives: Objectives, maximised: Objectives | None = None
) -> list[Estimate]:
    """The points that an archive holds for the front: no other one's cautious mean dominates theirs.

    Args:
        evaluations: of one search; those up to a generation give the front as it was then.
        objectives: of the estimates.
        maximised: by which points are compared, such as the one product of cmaes; `objectives` if absent.
    """
    evaluations = list(evaluations)
    compared = estimates(evaluations, maximised or objectives)
    if not compared:
        return []
    chosen = non_dominated([estimate.mean - CAUTION * estimate.std_error for estimate in compared])
    shown = estimates(evaluations, objectives)
    return [estimate for estimate, is_chosen in zip(shown, chosen, strict=True) if is_chosen]


def non_dominated(values: ArrayLike) -> NDArray[np.bool_]:
    """Which of the points with objectives (n, K), to be maximised, no other one dominates: (n,)."""
    values = np.asarray(values, np.float64)
    at_least = (values[:, None, :] >= values[None, :, :]).all(axis=2)
    better = (values[:, None, :] > values[None, :, :]).any(axis=2)
    return np.asarray(~(at_least & better).any(axis=0))


def hypervolume(values: ArrayLike) -> float:
    """Hypervolume that points with objectives (n, K) dominate, from the origin; all are maximised, in [0, 1]."""
    from pymoo.indicators.hv import HV  # noqa: PLC0415

    values = np.asarray(values, np.float64)
    return float(HV(ref_point=np.zeros(values.shape[1]))(-values))
