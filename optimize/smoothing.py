"""What a point's neighbours know about it: Gaussian process regression over all points that flew.

One flight's objectives scatter by a tenth (F_1) or a fifth (F_2) about the mean of their point, which changes slowly
from point to point. A mean over neighbours is then far surer than one flight: at points that had flown often, the
regression without their own flights was as good as some ten flights of their own.

Source: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), chapters 2 and 5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from threadpoolctl import threadpool_limits

MOST = 800
"""Points that are taken into a regression, those that flew most and latest; its time grows with their cube."""

_LENGTHS = (0.25, 0.5, 1.0, 2.0)
"""Distances over which objectives change, in widths of the range of the points; the likeliest is taken."""

_FEW = 200
"""Points by which the likeliest is found."""


class Smoothed(NamedTuple):
    """What is believed of n points.

    Attributes:
        mean: (n, K).
        deviation: (n, K), standard deviation of that belief; empty if it was not asked for.
    """

    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]


def smooth(
    points: NDArray[np.float64],
    flights: NDArray[np.float64],
    mean: NDArray[np.float64],
    variance: NDArray[np.float64],
    *,
    deviation: bool = False,
) -> Smoothed:
    """Believe each point's objectives by its own flights and by its neighbours'.

    Args:
        points: (n, 12), on any scale.
        flights: (n,), how many each point has.
        mean: (n, K), over them.
        variance: (K,), of one flight about its point's mean; where it is 0, nothing is smoothed.
        deviation: whether to say how sure this is, which takes longer.
    """
    if not variance.any():
        return Smoothed(mean, np.zeros_like(mean) if deviation else np.empty((0, mean.shape[1])))
    believed = mean.copy()
    errors = np.sqrt(variance / flights[:, None])
    taken = np.sort(np.lexsort((np.arange(len(points)), flights))[-MOST:])
    spread = np.ptp(points[taken], axis=0)
    squared = _squared_distances(points[taken] / np.where(spread > 0, spread, 1.0))
    # One thread: more would wait for the workers' processors, and sum in an order that depends on their number.
    with threadpool_limits(1, user_api="blas"):
        for k in np.flatnonzero(variance > 0):
            noise = variance[k] / flights[taken]
            believed[taken, k], error = _regress(squared, mean[taken, k], noise, deviation=deviation)
            if deviation:
                errors[taken, k] = error
    return Smoothed(
        believed,
        errors if deviation else np.empty((0, mean.shape[1])),
    )


def _regress(
    squared: NDArray[np.float64], values: NDArray[np.float64], noise: NDArray[np.float64], *, deviation: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean (m,) and standard deviation (m,), or nothing, of the belief in one objective.

    Args:
        squared: (m, m), squared distances.
        values: (m,), means over flights.
        noise: (m,), their variances.
        deviation: whether it is asked for.
    """
    # What the scatter of the means has beyond their noise is the points' own.
    scatter = float(np.var(values))
    signal = max(scatter - float(np.mean(noise)), 0.1 * scatter, 1e-9)
    length = _likeliest_length(squared, values, noise, signal)
    kernel = signal * np.exp(-squared / (2 * length**2))
    factor = cho_factor(kernel + np.diag(noise), lower=True)
    prior = float(np.average(values, weights=1 / (signal + noise)))
    believed = np.clip(prior + kernel @ cho_solve(factor, values - prior), 0.0, 1.0)
    if not deviation:
        return believed, np.empty(0)
    explained = np.einsum("ij,ij->j", kernel, cho_solve(factor, kernel))
    return believed, np.sqrt(np.maximum(signal - explained, 0.0))


def _likeliest_length(
    squared: NDArray[np.float64], values: NDArray[np.float64], noise: NDArray[np.float64], signal: float
) -> float:
    """Of _LENGTHS, that under which some of the values (m,) are likeliest."""
    few = np.linspace(0, len(values) - 1, min(_FEW, len(values))).astype(int)
    centred = values[few] - values[few].mean()
    likelihood = {}
    for length in _LENGTHS:
        kernel = signal * np.exp(-squared[np.ix_(few, few)] / (2 * length**2))
        factor = cho_factor(kernel + np.diag(noise[few]), lower=True)
        likelihood[length] = -0.5 * centred @ cho_solve(factor, centred) - np.log(np.diag(factor[0])).sum()
    return max(likelihood, key=lambda length: likelihood[length])


def _squared_distances(points: NDArray[np.float64]) -> NDArray[np.float64]:
    squares = (points**2).sum(axis=1)
    return np.asarray(np.maximum(squares[:, None] + squares[None, :] - 2 * points @ points.T, 0.0))
