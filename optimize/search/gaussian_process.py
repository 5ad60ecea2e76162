"""What flights tell about points: Gaussian process regression over all points that flew.

One flight's objectives scatter about the mean of their point, which changes slowly from point to point. A mean over
neighbours is then far surer than one flight: at points that had flown often, the regression without their own flights
was as good as some ten flights of their own. The scatter is no constant: flocks that hardly ever fail, or always,
scatter by a thirtieth, those between by a quarter; so it is learnt as a function of the mean.

Source: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), chapters 2, 4 and 5; noise that depends
on the mean after Goldberg, Williams and Bishop, Regression with input-dependent noise (NIPS 1997), with a kernel
average in place of their second process.

Flights of a cheaper model of the same thing may help: what they let believe, times a slope, is then the mean that is
expected of a point before it has flown, and the processes learn what the cheaper model has wrong (Kennedy and O'Hagan,
Predicting the output from a complex computer code when fast approximations are available, Biometrika 87, 2000).
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
"""Points that are taken into a regression, those that flew most and latest; its time grows with their cube."""

_SUBSET_SIZE = 200
"""Points that are enough to find the likeliest lengths, and a first belief by which the scatter is learnt."""

_LENGTH_BOUNDS = (0.08, 20.0)
"""Distances over which an objective changes along a coordinate, in widths of the range of the points. The prior of
each is log-normal about 1 with a factor e."""

_ITERATIONS = 25
"""Of the search for the likeliest lengths, which need not be found exactly."""

_GROWTH = 1.25
"""The lengths are sought again when there are so many more points."""

_LEVELS = np.linspace(0.0, 1.0, 51)
_LEVEL_WIDTH = 0.1
"""Means at which the scatter is learnt, and from how far around each."""

_PRIOR_FLIGHTS = 50.0
"""What the scatter over all points counts for at each level, in repeated flights. It must be many: points that were
lucky in a few flights look both good and steady."""

_MIN_VARIANCE = 1e-6

_SLOPE_DEVIATION = 0.5
"""Of the slope with which an objective rises with a cheaper model's, about 1, before anything is known."""


class Flights(NamedTuple):
    """What n points have flown, as sums over the flights of each.

    Attributes:
        points: (n, D), on any scale.
        number: (n,), flights of each point.
        total: (n, K), sums of their objectives, which lie in [0, 1].
        squares: (n, K), sums of the objectives' squares.
    """

    points: NDArray[np.float64]
    number: NDArray[np.float64]
    total: NDArray[np.float64]
    squares: NDArray[np.float64]

    @property
    def mean(self) -> NDArray[np.float64]:
        """(n, K)."""
        return np.asarray(self.total / self.number[:, None])


class Prediction(NamedTuple):
    """What is believed of points.

    Attributes:
        mean: (n, K).
        deviation: (n, K), standard deviation of that belief.
    """

    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]


class GaussianProcess:
    """The regression of some flights; of no use, and `noisy` false, before any point flew twice and differently.

    Args:
        flights: at least one point.
        before: of fewer flights of the same search, whose lengths still do.
        low_fidelity: of a cheaper model's flights; it helps once it is `noisy`.
    """

    def __init__(
        self, flights: Flights, before: GaussianProcess | None = None, low_fidelity: GaussianProcess | None = None
    ) -> None:
        self._flights = flights
        low_fidelity = low_fidelity if low_fidelity is not None and low_fidelity.noisy else None
        pooled = pooled_variance(flights)
        self.noisy: bool = bool(pooled.any())
        """Whether anything is known of the scatter."""
        if not self.noisy:
            return
        self._sought: int = len(flights.points)
        first: NDArray[np.float64] | None = None
        last: NDArray[np.float64] | None = None
        if before is not None and before.noisy and self._sought < _GROWTH * before._sought:
            self._sought, (first, last) = before._sought, before._lengths
        few = _Processes(flights, np.broadcast_to(pooled, flights.total.shape), _SUBSET_SIZE, first, low_fidelity)
        self._variance = flight_variance(flights, few.mean(flights.points))
        self._processes = _Processes(flights, self._variance, MAX_POINTS, last, low_fidelity)
        self._lengths: tuple[NDArray[np.float64], NDArray[np.float64]] = (few.lengths, self._processes.lengths)

    def mean(self) -> NDArray[np.float64]:
        """What is believed of the mean objectives (n, K) of the points that flew: their own means if not `noisy`."""
        mean = self._flights.mean
        if self.noisy:
            mean[self._processes.taken] = self._processes.own_mean
        return mean

    def prediction(self) -> Prediction:
        """The same with how sure it is."""
        deviation = np.zeros_like(self._flights.total)
        if self.noisy:
            taken = self._processes.taken
            deviation[:] = np.sqrt(self._variance / self._flights.number[:, None])
            deviation[taken] = self._processes.deviation(self._flights.points[taken])
        return Prediction(self.mean(), deviation)

    def predict(self, points: NDArray[np.float64]) -> Prediction:
        """What is to be expected of points (m, D) that have not flown; only if `noisy`."""
        return Prediction(self._processes.mean(points), self._processes.deviation(points))


def pooled_variance(flights: Flights) -> NDArray[np.float64]:
    """Variance (K,) of one flight about the mean of its point, over all points that flew more than once; 0 if none did.

    Args:
        flights: of any points.
    """
    freedom = float(np.sum(flights.number - 1))
    scatter = _scatter(flights).sum(axis=0)
    return np.asarray(scatter / freedom if freedom else np.zeros(flights.total.shape[1]))


def flight_variance(flights: Flights, level: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variance (n, K) of one flight about the mean of its point, learnt from points of about the same mean.

    Args:
        flights: some of them of points that flew more than once.
        level: (n, K), what is believed of the means.
    """
    pooled, scatter, freedom = pooled_variance(flights), _scatter(flights), flights.number - 1
    found = np.empty_like(level)
    for k in range(level.shape[1]):
        near = np.exp(-0.5 * ((_LEVELS[:, None] - level[:, k]) / _LEVEL_WIDTH) ** 2)
        learnt = (near @ scatter[:, k] + _PRIOR_FLIGHTS * pooled[k]) / (near @ freedom + _PRIOR_FLIGHTS)
        found[:, k] = np.interp(level[:, k], _LEVELS, learnt)
    return np.maximum(found, _MIN_VARIANCE)


def _scatter(flights: Flights) -> NDArray[np.float64]:
    """Sum of squares (n, K) about each point's own mean."""
    return np.asarray(np.maximum(flights.squares - flights.total**2 / flights.number[:, None], 0.0))


class _Processes:
    """One Gaussian process per objective, over at most `most` points.

    Args:
        flights: of all points.
        variance: (n, K), of one flight.
        most: those that flew most and latest are taken.
        lengths: (K, D), as `lengths` below; sought if None.
        low_fidelity: of a cheaper model's flights, or None.

    Attributes:
        taken: (m,), the numbers of the points that were taken.
        lengths: (K, D), distances over which each objective changes along each coordinate, in widths of the range.
        own_mean: (m, K), what is believed of the means of the points that were taken.
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
            guess = low_fidelity.predict(flights.points[self.taken]).mean
            self._slope = _slope(values, noise, guess)
            values = means - self._slope * guess
        # One thread: more would wait for the workers' processors, and sum in an order that depends on their number.
        with _one_thread():
            if lengths is None:
                few = np.linspace(0, len(values) - 1, min(_SUBSET_SIZE, len(values))).astype(int)
                rows = [
                    _likeliest_lengths(self._points[few], *pair)
                    for pair in zip(values[few].T, noise[few].T, strict=True)
                ]
                lengths = np.array(rows)
            self.lengths = lengths
            self._fits = [_fit(self._points, *row) for row in zip(values.T, noise.T, lengths, strict=True)]
        # What `mean` says at these points, without their kernel K: (K + diag noise) weights = values - prior.
        self.own_mean = np.clip(means - noise * np.stack([fit.weights for fit in self._fits], axis=1), 0.0, 1.0)

    def mean(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(m, K), at points (m, D), within [0, 1]."""
        scaled = points / self._width
        with _one_thread():
            columns = [fit.prior + _kernel(scaled, self._points, fit) @ fit.weights for fit in self._fits]
        mean = np.stack(columns, axis=1)
        if self._low_fidelity is not None:
            mean += self._slope * self._low_fidelity.predict(points).mean
        return np.clip(mean, 0.0, 1.0)

    def deviation(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(m, K), at points (m, D)."""
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
    """A process that has seen the values of one objective.

    Attributes:
        signal: variance of the points' own means.
        lengths: (D,), over which they change.
        prior: their mean.
        factor: of the values' covariance, as `cho_solve` takes it.
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
    """Fit one objective: points (m, D), means over flights (m,), and the variances of these (m,)."""
    signal = _signal(values, noise)
    prior = float(np.average(values, weights=1 / (signal + noise)))
    factor = cho_factor(_matern(points, points, signal, lengths) + np.diag(noise), lower=True)
    return _Fit(signal, lengths, prior, factor, cho_solve(factor, values - prior))


def _slope(values: NDArray[np.float64], noise: NDArray[np.float64], guess: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much means (m, K) of variances `noise` rise with what is guessed of them (m, K), at least 0: (K,).

    Least squares, with a prior that the cheaper model is right but for an offset.
    """
    rows = []
    for value, scatter, guessed in zip(values.T, noise.T, guess.T, strict=True):
        weights = 1 / (_signal(value, scatter) + scatter)
        centred = guessed - np.average(guessed, weights=weights)
        sure = 1 / _SLOPE_DEVIATION**2
        rows.append(max(float(weights @ (centred * value) + sure) / float(weights @ centred**2 + sure), 0.0))
    return np.array(rows)


def _signal(values: NDArray[np.float64], noise: NDArray[np.float64]) -> float:
    """What the scatter of the means (m,) has beyond their noise is the points' own."""
    scatter = float(np.var(values))
    return max(scatter - float(np.mean(noise)), 0.1 * scatter, 1e-9)


def _likeliest_lengths(
    points: NDArray[np.float64], values: NDArray[np.float64], noise: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The lengths (D,) under which values (m,) at points (m, D) are likeliest, about."""
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
    """Negative logarithm of a process's posterior, less what is constant, and its gradient (D,).

    Source: Rasmussen and Williams, equations 2.30 and 5.9.

    Args:
        log_lengths: (D,).
        points: (m, D).
        centred: (m,), values less their prior mean.
        noise: (m,), their variances.
        signal: variance of the points' own means.
    """
    lengths = np.exp(log_lengths)
    factor = cho_factor(_matern(points, points, signal, lengths) + np.diag(noise), lower=True)
    weights = cho_solve(factor, centred)
    pull = np.outer(weights, weights) - cho_solve(factor, np.eye(len(centred)))
    scaled = points / lengths
    r = np.sqrt(5 * _squared_distances(scaled, scaled))
    pull *= signal * 5 / 3 * (1 + r) * np.exp(-r)  # times (x_i - x_j)^2 / l^2: derivative by log l
    gradient = -(pull.sum(axis=1) @ scaled**2 - np.einsum("id,ij,jd->d", scaled, pull, scaled, optimize=True))
    unlikely = 0.5 * centred @ weights + np.log(np.diag(factor[0])).sum() + 0.5 * np.sum(log_lengths**2)
    return float(unlikely), gradient + log_lengths


def _kernel(points: NDArray[np.float64], known: NDArray[np.float64], fit: _Fit) -> NDArray[np.float64]:
    return _matern(points, known, fit.signal, fit.lengths)


def _matern(
    a: NDArray[np.float64], b: NDArray[np.float64], signal: float, lengths: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Matern's covariance of smoothness 5/2 (equation 4.17) of points (n, D) and (m, D): (n, m)."""
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
    """Between points (n, D) and points (m, D): (n, m)."""
    squares = (-2 * a) @ b.T
    squares += (a**2).sum(axis=1)[:, None]
    squares += (b**2).sum(axis=1)
    return np.maximum(squares, 0.0, out=squares)


@functools.cache
def _controller() -> ThreadpoolController:
    """Finding the libraries that a process has loaded takes longer than a small regression."""
    return ThreadpoolController()


def _one_thread() -> AbstractContextManager[object]:
    limit: AbstractContextManager[object] = _controller().limit(limits=1, user_api="blas")
    return limit
