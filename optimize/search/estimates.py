"""Estimates from an archive: mean objectives of its points, their standard errors, and the front."""

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
"""Standard errors subtracted from a mean before points are compared, so that noise alone puts no point on the front."""


class Estimate(NamedTuple):
    """Estimate of a point's mean objectives.

    Attributes:
        params: the point.
        mean: (K,), mean predicted by a Gaussian process over all flights (`gaussian_process`). If no point flew twice,
            the noise is unknown, and it is the mean of the point's own flights.
        std_error: (K,), standard deviation of the prediction.
        flights: number of flights of the point.
    """

    params: NamedTuple
    mean: NDArray[np.float64]
    std_error: NDArray[np.float64]
    flights: int


def estimates(evaluations: Iterable[Evaluation], objectives: Objectives) -> list[Estimate]:
    """One estimate per point, in the order of the points' first flights."""
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
    predicted = GaussianProcess(flown).prediction()
    return [
        Estimate(params, mean, error, int(number))
        for params, mean, error, number in zip(flights, predicted.mean, predicted.deviation, flown.number, strict=True)
    ]


def estimated_front(
    evaluations: Iterable[Evaluation], objectives: Objectives, maximised: Objectives | None = None
) -> list[Estimate]:
    """Estimates of the points whose means less CAUTION standard errors are not dominated by another point's.

    Args:
        evaluations: evaluations of one search; those up to a generation give the front after that generation.
        objectives: objectives of the returned estimates.
        maximised: objectives by which the points are compared, such as the product for cmaes; default: `objectives`.
    """
    evaluations = list(evaluations)
    compared = estimates(evaluations, maximised or objectives)
    if not compared:
        return []
    on_front = non_dominated([estimate.mean - CAUTION * estimate.std_error for estimate in compared])
    returned = estimates(evaluations, objectives)
    return [estimate for estimate, kept in zip(returned, on_front, strict=True) if kept]


def non_dominated(values: ArrayLike) -> NDArray[np.bool_]:
    """Mask (n,) of the points with objectives (n, K), to be maximised, that no other point dominates."""
    values = np.asarray(values, np.float64)
    at_least = (values[:, None, :] >= values[None, :, :]).all(axis=2)
    better = (values[:, None, :] > values[None, :, :]).any(axis=2)
    return np.asarray(~(at_least & better).any(axis=0))


def hypervolume(values: ArrayLike) -> float:
    """Hypervolume between the origin and points with objectives (n, K) in [0, 1], which are maximised."""
    from pymoo.indicators.hv import HV  # noqa: PLC0415

    values = np.asarray(values, np.float64)
    return float(HV(ref_point=np.zeros(values.shape[1]))(-values))
