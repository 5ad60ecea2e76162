"""Gaussian process regression of the mean objectives over all points that have flown.

The objectives of a flight are the mean objectives of its point plus noise, and the means change slowly from point to
point. A regression over neighbours is therefore more accurate than a single flight: at points with many flights, the
regression without these flights was as accurate as about ten of them. The noise depends on the mean: its standard
deviation is about 1/30 for flocks that nearly always succeed or nearly always fail, and about 1/4 between these. It is
therefore estimated as a function of the mean.

Source: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), chapters 2, 4 and 5. Noise that depends
on the mean follows Goldberg, Williams and Bishop, Regression with input-dependent noise (NIPS 1997), with a kernel
average in place of their second process.

Low-fidelity flights can help: their prediction, scaled by a slope, is the prior mean of the high-fidelity objective,
and the processes model the difference (Kennedy and O'Hagan, Predicting the output from a complex computer code when
fast approximations are available, Biometrika 87, 2000).
"""

from __future__ import annotations

import functools
from contextlib import AbstractContextManager
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from threadpoolctl import ThreadpoolController

MAX_POINTS = 800
"""Largest number of points in a regression, whose time grows with its cube; those with the most flights are used."""

_SUBSET_SIZE = 200
"""Number of points for the optimisation of the lengths, and for the first prediction, which gives the noise."""

_LENGTH_BOUNDS = (0.08, 20.0)
"""Bounds of the kernel's length scales, in widths of the range of the points. The prior of each length is log-normal
with median 1 and a standard deviation of a factor e."""

_ITERATIONS = 25
"""Largest number of iterations in the optimisation of the lengths, which need not be exact."""

_GROWTH = 1.25
"""Growth factor of the number of points after which the lengths are optimised again."""

_LEVELS = np.linspace(0.0, 1.0, 51)
_LEVEL_WIDTH = 0.1
"""Means at which the noise is estimated, and standard deviation of the averaging kernel around each."""

_PRIOR_FLIGHTS = 50.0
"""Weight of the pooled variance at each level, in repeated flights. It must be large: points with few flights that
happen to be good appear to have a high mean and a low variance."""

_MIN_VARIANCE = 1e-6  # keeps the covariance matrix well-conditioned

_SLOPE_DEVIATION = 0.5
"""Prior standard deviation of the slope between the low-fidelity and the high-fidelity objective; its mean is 1."""


class Flights(NamedTuple):
    """Flights of n points, as sums over the flights of each point.

    Attributes:
        points: (n, D), on any scale.
        number: (n,), number of flights of each point.
        total: (n, K), sums of the objectives, which are in [0, 1].
        squares: (n, K), sums of the squares of the objectives.
    """

    points: NDArray[np.float64]
    number: NDArray[np.float64]
    total: NDArray[np.float64]
    squares: NDArray[np.float64]

    @property
    def mean(self) -> NDArray[np.float64]:
        """(n, K), mean objectives of each point's own flights."""
        return np.asarray(self.total / self.number[:, None])


class Prediction(NamedTuple):
    """Prediction of the mean objectives of n points.

    Attributes:
        mean: (n, K), predicted mean.
        deviation: (n, K), standard deviation of the prediction.
    """

    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]


class GaussianProcess:
    """Gaussian process regression of flights.

    It makes no predictions, and `noisy` is False, before a point has two different flights.

    Args:
        flights: flights of at least one point.
        before: regression of fewer flights of the same search; its lengths are reused for a while.
        low_fidelity: regression of low-fidelity flights; it is used once it is `noisy`.
    """

    def __init__(
        self, flights: Flights, before: GaussianProcess | None = None, low_fidelity: GaussianProcess | None = None
    ) -> None:
        self._flights = flights
        low_fidelity = low_fidelity if low_fidelity is not None and low_fidelity.noisy else None
        pooled = pooled_variance(flights)
        self.noisy: bool = bool(pooled.any())
        """Whether the noise can be estimated."""
        if not self.noisy:
            return
        self._optimised_at: int = len(flights.points)
        first: NDArray[np.float64] | None = None
        last: NDArray[np.float64] | None = None
        if before is not None and before.noisy and self._optimised_at < _GROWTH * before._optimised_at:
            self._optimised_at, (first, last) = before._optimised_at, before._lengths
        subset = _Processes(flights, np.broadcast_to(pooled, flights.total.shape), _SUBSET_SIZE, first, low_fidelity)
        self._variance = flight_variance(flights, subset.mean(flights.points))
        self._processes = _Processes(flights, self._variance, MAX_POINTS, last, low_fidelity)
        self._lengths: tuple[NDArray[np.float64], NDArray[np.float64]] = (subset.lengths, self._processes.lengths)

    def mean(self) -> NDArray[np.float64]:
        """Estimated mean objectives (n, K) of the points that have flown; their own means if not `noisy`."""
        mean = self._flights.mean
        if self.noisy:
            mean[self._processes.taken] = self._processes.own_mean
        return mean

    def prediction(self) -> Prediction:
        """Estimated mean objectives of the points that have flown, with standard deviations."""
        deviation = np.zeros_like(self._flights.total)
        if self.noisy:
            taken = self._processes.taken
            deviation[:] = np.sqrt(self._variance / self._flights.number[:, None])
            deviation[taken] = self._processes.deviation(self._flights.points[taken])
        return Prediction(self.mean(), deviation)

    def predict(self, points: NDArray[np.float64]) -> Prediction:
        """Predict the mean objectives of points (m, D) that have not flown; only if `noisy`."""
        return Prediction(self._processes.mean(points), self._processes.deviation(points))


def pooled_variance(flights: Flights) -> NDArray[np.float64]:
    """Variance (K,) of a flight about the mean of its point, pooled over all points; 0 without repeated flights."""
    freedom = float(np.sum(flights.number - 1))
    scatter = _scatter(flights).sum(axis=0)
    return np.asarray(scatter / freedom if freedom else np.zeros(flights.total.shape[1]))


def flight_variance(flights: Flights, level: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variance (n, K) of a flight about the mean of its point, estimated from points with similar means.

    Args:
        flights: flights, some of them repeated at the same point.
        level: (n, K), estimated means of the points.
    """
    pooled, scatter, freedom = pooled_variance(flights), _scatter(flights), flights.number - 1
    found = np.empty_like(level)
    for k in range(level.shape[1]):
        near = np.exp(-0.5 * ((_LEVELS[:, None] - level[:, k]) / _LEVEL_WIDTH) ** 2)
        variance = (near @ scatter[:, k] + _PRIOR_FLIGHTS * pooled[k]) / (near @ freedom + _PRIOR_FLIGHTS)
        found[:, k] = np.interp(level[:, k], _LEVELS, variance)
    return np.maximum(found, _MIN_VARIANCE)


def _scatter(flights: Flights) -> NDArray[np.float64]:
    """Sums of squares (n, K) about each point's own mean."""
    return np.asarray(np.maximum(flights.squares - flights.total**2 / flights.number[:, None], 0.0))


class _Processes:
    """One Gaussian process per objective, over at most `most` points.

    Args:
        flights: flights of all points.
        variance: (n, K), variance of one flight.
        most: largest number of points; those with the most flights are used, and the latest of equals.
        lengths: (K, D), as `lengths` below; optimised if None.
        low_fidelity: regression of low-fidelity flights, or None.

    Attributes:
        taken: (m,), indices of the points that are used.
        lengths: (K, D), length scales of each objective along each coordinate, in widths of the range of the points.
        own_mean: (m, K), estimated mean objectives of the points that are used.
    """

    def __init__(
        self,
        flights: Flights,
        variance: NDArray[np.float64],
        most: int,
        lengths: NDArray[np.float64] | None,
        low_fidelity: GaussianProcess | None,
    ) -> None:
        self.taken = np.sort(np.lexsort((np.arange(len(flights.points)), flights.number))[-most:])
        spread = np.ptp(flights.points[self.taken], axis=0)
        self._width = np.where(spread > 0, spread, 1.0)
        self._points = flights.points[self.taken] / self._width
        values = means = flights.mean[self.taken]
        noise = np.maximum(variance[self.taken], _MIN_VARIANCE) / flights.number[self.taken, None]
        self._low_fidelity, self._slope = low_fidelity, np.zeros(values.shape[1])
        if low_fidelity is not None:
            low_mean = low_fidelity.predict(flights.points[self.taken]).mean
            self._slope = _slope(values, noise, low_mean)
            values = means - self._slope * low_mean
        # More threads would compete with the workers, and the result would depend on their number.
        with _one_thread():
            if lengths is None:
                chosen = np.linspace(0, len(values) - 1, min(_SUBSET_SIZE, len(values))).astype(int)
                rows = [
                    _optimal_lengths(self._points[chosen], *pair)
                    for pair in zip(values[chosen].T, noise[chosen].T, strict=True)
                ]
                lengths = np.array(rows)
            self.lengths = lengths
            self._fits = [_fit(self._points, *row) for row in zip(values.T, noise.T, lengths, strict=True)]
        # Equal to `mean` at these points, but without the kernel K: (K + diag noise) weights = values - prior.
        self.own_mean = np.clip(means - noise * np.stack([fit.weights for fit in self._fits], axis=1), 0.0, 1.0)

    def mean(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Predicted means (m, K) at points (m, D), in [0, 1]."""
        scaled = points / self._width
        with _one_thread():
            columns = [fit.prior + _kernel(scaled, self._points, fit) @ fit.weights for fit in self._fits]
        mean = np.stack(columns, axis=1)
        if self._low_fidelity is not None:
            mean += self._slope * self._low_fidelity.predict(points).mean
        return np.clip(mean, 0.0, 1.0)

    def deviation(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Standard deviations (m, K) of the prediction at points (m, D)."""
        scaled, columns = points / self._width, []
        with _one_thread():
            for fit in self._fits:
                kernel = _kernel(scaled, self._points, fit)
                explained = np.einsum("ij,ji->i", kernel, cho_solve(fit.factor, kernel.T))
                columns.append(np.sqrt(np.maximum(fit.signal - explained, 0.0)))
        deviation = np.stack(columns, axis=1)
        if self._low_fidelity is not None:
            deviation = np.hypot(deviation, self._slope * self._low_fidelity.predict(points).deviation)
        return deviation


class _Fit(NamedTuple):
    """Gaussian process fitted to one objective.

    Attributes:
        signal: variance of the mean objective over the points.
        lengths: (D,), length scales.
        prior: prior mean.
        factor: Cholesky factor of the values' covariance, in the form that `cho_solve` takes.
        weights: (m,), covariance^-1 (values - prior).
    """

    signal: float
    lengths: NDArray[np.float64]
    prior: float
    factor: tuple[NDArray[np.float64], bool]
    weights: NDArray[np.float64]


def _fit(
    points: NDArray[np.float64],
    values: NDArray[np.float64],
    noise: NDArray[np.float64],
    lengths: NDArray[np.float64],
) -> _Fit:
    """Fit a process to one objective: points (m, D), means over flights (m,), and their variances (m,)."""
    signal = _signal(values, noise)
    prior = float(np.average(values, weights=1 / (signal + noise)))
    factor = cho_factor(_matern(points, points, signal, lengths) + np.diag(noise), lower=True)
    return _Fit(signal, lengths, prior, factor, cho_solve(factor, values - prior))


def _slope(
    values: NDArray[np.float64], noise: NDArray[np.float64], low_mean: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Slopes (K,), at least 0, of means (m, K) with variances `noise` over the low-fidelity predictions (m, K).

    The slopes are least-squares estimates with a prior of 1, for a low-fidelity model that is right up to an offset.
    """
    rows = []
    for value, variance, low in zip(values.T, noise.T, low_mean.T, strict=True):
        weights = 1 / (_signal(value, variance) + variance)
        centred = low - np.average(low, weights=weights)
        precision = 1 / _SLOPE_DEVIATION**2
        rows.append(max(float(weights @ (centred * value) + precision) / float(weights @ centred**2 + precision), 0.0))
    return np.array(rows)


def _signal(values: NDArray[np.float64], noise: NDArray[np.float64]) -> float:
    """Variance of the mean objective over the points: that of the observed means (m,) less their noise."""
    scatter = float(np.var(values))
    return max(scatter - float(np.mean(noise)), 0.1 * scatter, 1e-9)


def _optimal_lengths(
    points: NDArray[np.float64], values: NDArray[np.float64], noise: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Length scales (D,) of approximately maximal posterior, for values (m,) at points (m, D)."""
    signal = _signal(values, noise)
    centred = values - np.average(values, weights=1 / (signal + noise))
    bounds = [tuple(np.log(_LENGTH_BOUNDS))] * points.shape[1]
    found = minimize(
        negative_log_marginal_likelihood,
        np.zeros(points.shape[1]),
        args=(points, centred, noise, signal),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": _ITERATIONS},
    )
    return np.asarray(np.exp(found.x))


def negative_log_marginal_likelihood(
    log_lengths: NDArray[np.float64],
    points: NDArray[np.float64],
    centred: NDArray[np.float64],
    noise: NDArray[np.float64],
    signal: float,
) -> tuple[float, NDArray[np.float64]]:
    """Negative logarithm of a process's posterior without constant terms, and its gradient (D,).

    Source: Rasmussen and Williams, equations 2.30 and 5.9.

    Args:
        log_lengths: (D,), logarithms of the length scales.
        points: (m, D), the points.
        centred: (m,), values minus their prior mean.
        noise: (m,), variances of the values.
        signal: variance of the mean objective over the points.
    """
    lengths = np.exp(log_lengths)
    factor = cho_factor(_matern(points, points, signal, lengths) + np.diag(noise), lower=True)
    weights = cho_solve(factor, centred)
    inner = np.outer(weights, weights) - cho_solve(factor, np.eye(len(centred)))
    scaled = points / lengths
    r = np.sqrt(5 * _squared_distances(scaled, scaled))
    inner *= signal * 5 / 3 * (1 + r) * np.exp(-r)  # times (x_i - x_j)^2 / l^2: derivative by log l
    gradient = -(inner.sum(axis=1) @ scaled**2 - np.einsum("id,ij,jd->d", scaled, inner, scaled, optimize=True))
    negative_log = 0.5 * centred @ weights + np.log(np.diag(factor[0])).sum() + 0.5 * np.sum(log_lengths**2)
    return float(negative_log), gradient + log_lengths


def _kernel(points: NDArray[np.float64], known: NDArray[np.float64], fit: _Fit) -> NDArray[np.float64]:
    return _matern(points, known, fit.signal, fit.lengths)


def _matern(
    a: NDArray[np.float64], b: NDArray[np.float64], signal: float, lengths: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Matern covariance (n, m) with smoothness 5/2 (equation 4.17) between points (n, D) and (m, D)."""
    r = _squared_distances(a / lengths, b / lengths)
    r *= 5
    np.sqrt(r, out=r)
    polynomial = r / 3
    polynomial += 1
    polynomial *= r
    polynomial += 1
    polynomial *= signal
    np.exp(np.negative(r, out=r), out=r)
    r *= polynomial
    return r


def _squared_distances(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared distances (n, m) between points (n, D) and points (m, D)."""
    squares = (-2 * a) @ b.T
    squares += (a**2).sum(axis=1)[:, None]
    squares += (b**2).sum(axis=1)
    return np.maximum(squares, 0.0, out=squares)


@functools.cache
def _controller() -> ThreadpoolController:
    """Thread pool controller of this process; cached because its construction takes longer than a small regression."""
    return ThreadpoolController()


def _one_thread() -> AbstractContextManager[object]:
    limit: AbstractContextManager[object] = _controller().limit(limits=1, user_api="blas")
    return limit
