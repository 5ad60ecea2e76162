"""Moving air: a constant mean wind, and gusts in it by the Dryden model of MIL-F-8785C.

The gusts are those of low altitude (up to 1000 ft): with the height h in feet and the wind W20 at 20 ft,
    L_w = h, L_u = L_v = h / (0.177 + 0.000823 h)^1.2,
    sigma_w = 0.1 W20, sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4.
Along the wind (u) the spectrum is that of white noise through a first-order filter, across and up (v, w) of second
order; over the spatial frequency Omega in rad/m,
    Phi_u = sigma^2 2 L / (pi (1 + (L Omega)^2)),
    Phi_v = sigma^2 L (1 + 3 (L Omega)^2) / (pi (1 + (L Omega)^2)^2).
A drone meets them with its airspeed V, so that they change with the time constant T = L / V.

Each drone has a gust of its own, independent of all others. That is right where drones are farther apart than the
scale lengths (some 100 m across, the height upwards) and too hard on a dense flock, whose drones real gusts would push
together. The mean wind is the same at every height.
"""

from __future__ import annotations

from math import exp, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import Off, hot_kernel, hot_stage, implements, kernel, stage
from moflock_mj.errors import ScenarioError
from moflock_mj.scenario import Scenario

FOOT = 0.3048
"""m."""

HEIGHTS = (10 * FOOT, 1000 * FOOT)
"""Of the low-altitude model, m. Lower down the gusts are those at its lower end."""

SLOWEST = 1.0
"""m/s, airspeed below which gusts change no more slowly: air that stands still changes too."""


class SteadyWind(NamedTuple):
    """Air of constant velocity.

    Attributes:
        velocity_x: m/s, world; so is velocity_y.
        velocity_y: m/s, world.
    """

    velocity_x: float
    velocity_y: float


class Gusts(NamedTuple):
    """A mean wind with Dryden turbulence.

    Attributes:
        mean: (2,), m/s, world.
        along: (2,), unit vector of the mean wind, world.
        period: s, from one change of the gusts to the next.
        length_u: m, scale along and across the wind.
        length_w: m, scale upwards.
        sigma_u: m/s, deviation along and across the wind.
        sigma_w: m/s, deviation upwards.
        filters: (5, N), m/s, states of the filters: u; two of v; two of w.
        velocity: (3, N), m/s, world, of the air at each drone.
    """

    mean: NDArray[np.float64]
    along: NDArray[np.float64]
    period: float
    length_u: float
    length_w: float
    sigma_u: float
    sigma_w: float
    filters: NDArray[np.float64]
    velocity: NDArray[np.float64]


GUST_DRAWS = 5
"""Normal numbers that a drone's gusts take each time they change."""


def dryden_scales(height: float, w20: float) -> tuple[float, float, float, float]:
    """Lengths L_u = L_v and L_w in m and deviations sigma_u = sigma_v and sigma_w in m/s; see the top of this room.

    Args:
        height: m above the ground.
        w20: m/s, wind at 6 m (20 ft).
    """
    feet = max(height, HEIGHTS[0]) / FOOT
    shape = 0.177 + 0.000823 * feet
    sigma_w = 0.1 * w20
    return feet / shape**1.2 * FOOT, feet * FOOT, sigma_w / shape**0.4, sigma_w


def make_wind(scenario: Scenario, period: float, rng: np.random.Generator) -> NamedTuple:
    """The wind of a scenario.

    Args:
        scenario: whose `wind` is on or off.
        period: s, time between two calls of `blow`.
        rng: of the gusts at the start.

    Raises:
        ScenarioError: the flock flies higher than gusts are modelled.
    """
    wind = scenario.wind
    if wind is None:
        return Off()
    along = np.array([np.cos(wind.direction), np.sin(wind.direction)])
    mean = wind.speed * along
    if wind.gust_wind == 0:
        return SteadyWind(float(mean[0]), float(mean[1]))
    if scenario.altitude > HEIGHTS[1]:
        raise ScenarioError(
            f"altitude: {scenario.altitude:g} m is out of bounds: with gusts it must be at most {HEIGHTS[1]:g} m"
        )
    length_u, length_w, sigma_u, sigma_w = dryden_scales(scenario.altitude, wind.gust_wind)
    draws = rng.standard_normal((GUST_DRAWS, scenario.drones))
    filters = np.empty_like(draws)
    filters[0] = sigma_u * draws[0]
    for first, sigma in ((1, sigma_u), (3, sigma_w)):
        # The stationary covariance, see `_second_order`.
        filters[first] = sigma * sqrt(0.5) * draws[first]
        filters[first + 1] = sigma * sqrt(0.5) * (draws[first] + draws[first + 1]) / 2
    gusts = Gusts(mean, along, period, length_u, length_w, sigma_u, sigma_w, filters, np.zeros((3, scenario.drones)))
    _write_velocity(gusts)
    return gusts


@stage
def blow(wind: NamedTuple, velocity: NDArray[np.float64], draws: NDArray[np.float64]) -> None:
    """Let the gusts change for one period; chosen by the type of `wind`.

    Args:
        wind: the air.
        velocity: (3, N), m/s, world, of the drones.
        draws: (1, 5, N), N(0, 1); (0, 5, N) where there are no gusts.
    """


@hot_stage
def air_velocity(wind: NamedTuple, i: int) -> tuple[float, float, float]:
    """Velocity of the air at drone i, m/s, world; chosen by the type of `wind`."""
    raise NotImplementedError


@implements(blow, Off)
@implements(blow, SteadyWind)
def _blow_steadily(wind: NamedTuple, velocity: NDArray[np.float64], draws: NDArray[np.float64]) -> None:
    pass


@implements(air_velocity, Off)
def _still_velocity(wind: Off, i: int) -> tuple[float, float, float]:  # noqa: ARG001
    return 0.0, 0.0, 0.0


@implements(air_velocity, SteadyWind)
def _steady_velocity(wind: SteadyWind, i: int) -> tuple[float, float, float]:  # noqa: ARG001
    return wind.velocity_x, wind.velocity_y, 0.0


@implements(air_velocity, Gusts)
def _gust_velocity(wind: Gusts, i: int) -> tuple[float, float, float]:
    return wind.velocity[0, i], wind.velocity[1, i], wind.velocity[2, i]


@hot_kernel
def _second_order(p: float, q: float, sigma: float, ratio: float, draw_p: float, draw_q: float) -> tuple[float, float]:
    """Both states of a lateral filter one period on, exactly.

    The filter (1 + sqrt(3) T s) / (1 + T s)^2 is sqrt(3) p + (1 - sqrt(3)) q with p' = (n - p) / T, q' = (p - q) / T.
    Its output has the variance sigma^2 if p has sigma^2 / 2; then q has half of that, and so has their covariance.

    Args:
        p: m/s, first state.
        q: m/s, second state.
        sigma: m/s, deviation of the output.
        ratio: period over T.
        draw_p: N(0, 1).
        draw_q: N(0, 1).
    """
    decay = exp(-ratio)
    kept, half = decay * decay, sigma * sigma / 4
    # What the noise of this period adds to the covariance: the stationary one, less what is kept of it.
    pp = 2 * half * (1 - kept)
    pq = half * (1 - kept * (1 + 2 * ratio))
    qq = half * (1 - kept * (1 + 2 * ratio * (1 + ratio)))
    root = sqrt(pp)
    next_p = decay * p + root * draw_p
    next_q = decay * (q + ratio * p) + pq / root * draw_p + sqrt(max(qq - pq * pq / pp, 0.0)) * draw_q
    return next_p, next_q


@kernel
def _write_velocity(wind: Gusts) -> None:
    """The air's velocity in the world from the filters' states."""
    filters, root3 = wind.filters, sqrt(3.0)
    for i in range(filters.shape[1]):
        u = filters[0, i]
        v = root3 * filters[1, i] + (1 - root3) * filters[2, i]
        wind.velocity[0, i] = wind.mean[0] + wind.along[0] * u - wind.along[1] * v
        wind.velocity[1, i] = wind.mean[1] + wind.along[1] * u + wind.along[0] * v
        wind.velocity[2, i] = root3 * filters[3, i] + (1 - root3) * filters[4, i]


@implements(blow, Gusts)
def _blow_gusts(wind: Gusts, velocity: NDArray[np.float64], draws: NDArray[np.float64]) -> None:
    filters, air = wind.filters, wind.velocity
    for i in range(filters.shape[1]):
        x, y, z = velocity[0, i] - air[0, i], velocity[1, i] - air[1, i], velocity[2, i] - air[2, i]
        way = max(sqrt(x * x + y * y + z * z), SLOWEST) * wind.period
        ratio_u, ratio_w = way / wind.length_u, way / wind.length_w
        decay = exp(-ratio_u)
        filters[0, i] = decay * filters[0, i] + wind.sigma_u * sqrt(1 - decay * decay) * draws[0, 0, i]
        filters[1, i], filters[2, i] = _second_order(
            filters[1, i], filters[2, i], wind.sigma_u, ratio_u, draws[0, 1, i], draws[0, 2, i]
        )
        filters[3, i], filters[4, i] = _second_order(
            filters[3, i], filters[4, i], wind.sigma_w, ratio_w, draws[0, 3, i], draws[0, 4, i]
        )
    _write_velocity(wind)
