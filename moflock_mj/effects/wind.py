"""Wind: constant mean wind and gusts by the Dryden model of MIL-F-8785C.

The gusts are those of low altitude (up to 1000 ft), with the height h in feet and the wind W20 at 20 ft:
    L_w = h, L_u = L_v = h / (0.177 + 0.000823 h)^1.2,
    sigma_w = 0.1 W20, sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4.
The spectrum along the wind (u) is that of white noise through a first-order filter, and across and upwards (v, w) of
second order. Over the spatial frequency Omega in rad/m,
    Phi_u = sigma^2 2 L / (pi (1 + (L Omega)^2)),
    Phi_v = sigma^2 L (1 + 3 (L Omega)^2) / (pi (1 + (L Omega)^2)^2).
A drone crosses the gusts at its airspeed V, so that they change with the time constant T = L / V.

The gusts of different drones are independent. This is accurate for distances above the scale lengths (about 100 m
horizontally, the height vertically). It is pessimistic for a dense flock, where real gusts move neighbouring drones
together. The mean wind is the same at every height.
"""

from __future__ import annotations

from math import exp, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import Off, hot_stage, implements, kernel, stage
from moflock_mj.errors import ScenarioError
from moflock_mj.scenario.scenario import Scenario

FOOT = 0.3048
"""One foot, m."""

HEIGHTS = (10 * FOOT, 1000 * FOOT)
"""Range of the low-altitude model, m. Below it, gusts are those at its lower end."""

SLOWEST = 1.0
"""Smallest airspeed in the time constant of gusts, m/s, so that gusts also change for a drone at rest in the air."""


class Wind(NamedTuple):
    """Constant wind with Dryden turbulence; deviations of 0 give a steady wind.

    Attributes:
        speed: speed of the mean wind, m/s.
        along: (2,), unit vector of the mean wind, world.
        period: interval between two updates of the gusts, s.
        length_u: scale length along and across the wind, m.
        length_w: vertical scale length, m.
        sigma_u: standard deviation along and across the wind, m/s.
        sigma_w: vertical standard deviation, m/s.
        filters: (5, N), filter states for gusts of unit deviation: one of u, two of v, two of w.
        velocity: (3, N), velocity of the air at each drone, m/s, world.
    """

    speed: float
    along: NDArray[np.float64]
    period: float
    length_u: float
    length_w: float
    sigma_u: float
    sigma_w: float
    filters: NDArray[np.float64]
    velocity: NDArray[np.float64]


GUST_DRAWS = 5
"""Number of normal random numbers per drone and update of the gusts."""


def dryden_scales(height: float, w20: float) -> tuple[float, float, float, float]:
    """Scale lengths L_u = L_v, L_w (m) and deviations sigma_u = sigma_v, sigma_w (m/s); see the module docstring.

    Args:
        height: height above the ground, m.
        w20: wind at 6 m (20 ft), m/s.
    """
    feet = max(height, HEIGHTS[0]) / FOOT
    shape = 0.177 + 0.000823 * feet
    sigma_w = 0.1 * w20
    return feet / shape**1.2 * FOOT, feet * FOOT, sigma_w / shape**0.4, sigma_w


def make_wind(scenario: Scenario, period: float, rng: np.random.Generator) -> Wind | Off:
    """Create the wind of a scenario, or Off without wind.

    Args:
        scenario: the scenario.
        period: interval between two calls of `blow`, s.
        rng: generator of the initial gusts.

    Raises:
        ScenarioError: the altitude is above the range of the gust model.
    """
    section, drones = scenario.wind, scenario.drones
    if section is None:
        return Off()
    if section.gust_wind > 0 and scenario.altitude > HEIGHTS[1]:
        raise ScenarioError(
            f"altitude: {scenario.altitude:g} m is out of bounds: with gusts it must be at most {HEIGHTS[1]:g} m"
        )
    along = np.array([np.cos(section.direction), np.sin(section.direction)])
    filters = rng.standard_normal((GUST_DRAWS, drones))
    for first in (1, 3):
        # Initialise with the stationary covariance, see `_second_order`.
        filters[first + 1] = (filters[first] + filters[first + 1]) / 2 * sqrt(0.5)
        filters[first] *= sqrt(0.5)
    scales = dryden_scales(scenario.altitude, section.gust_wind)
    wind = Wind(section.speed, along, period, *scales, filters, np.zeros((3, drones)))
    _write_velocity(wind)
    return wind


@stage
def blow(wind: NamedTuple, velocity: NDArray[np.float64], draws: NDArray[np.float64]) -> None:
    """Advance the gusts by one period; no effect without wind.

    Args:
        wind: the wind; updated.
        velocity: (3, N), velocity of the drones, m/s, world.
        draws: (1, 5, N), N(0, 1); (0, 5, N) without wind, and to keep the gusts.
    """


@hot_stage
def air_velocity(wind: NamedTuple, i: int) -> tuple[float, float, float]:
    """Velocity of the air at drone i, m/s, world; zero without wind."""
    return 0.0, 0.0, 0.0


@implements(air_velocity, Wind)
def _wind_velocity(wind: Wind, i: int) -> tuple[float, float, float]:
    return wind.velocity[0, i], wind.velocity[1, i], wind.velocity[2, i]


@kernel
def _second_order(p: float, q: float, ratio: float, draw_p: float, draw_q: float) -> tuple[float, float]:
    """Advance both states of a second-order filter by one period, exactly.

    The filter (1 + sqrt(3) T s) / (1 + T s)^2 is sqrt(3) p + (1 - sqrt(3)) q with p' = (n - p) / T, q' = (p - q) / T.
    For an output variance of 1, the variance of p is 1/2, that of q is 1/4, and their covariance is 1/4.

    Args:
        p: first state.
        q: second state.
        ratio: period divided by T.
        draw_p: N(0, 1).
        draw_q: N(0, 1).
    """
    decay = exp(-ratio)
    kept = decay * decay
    # The noise of this period adds the stationary covariance less its decayed part.
    pp = (1 - kept) / 2
    pq = (1 - kept * (1 + 2 * ratio)) / 4
    qq = (1 - kept * (1 + 2 * ratio * (1 + ratio))) / 4
    root = sqrt(pp)
    next_p = decay * p + root * draw_p
    next_q = decay * (q + ratio * p) + pq / root * draw_p + sqrt(max(qq - pq * pq / pp, 0.0)) * draw_q
    return next_p, next_q


@kernel
def _write_velocity(wind: Wind) -> None:
    """Update the velocity of the air from the filter states."""
    filters, root3 = wind.filters, sqrt(3.0)
    for i in range(filters.shape[1]):
        u = wind.sigma_u * filters[0, i]
        v = wind.sigma_u * (root3 * filters[1, i] + (1 - root3) * filters[2, i])
        wind.velocity[0, i] = wind.speed * wind.along[0] + wind.along[0] * u - wind.along[1] * v
        wind.velocity[1, i] = wind.speed * wind.along[1] + wind.along[1] * u + wind.along[0] * v
        wind.velocity[2, i] = wind.sigma_w * (root3 * filters[3, i] + (1 - root3) * filters[4, i])


@implements(blow, Wind)
def _blow(wind: Wind, velocity: NDArray[np.float64], draws: NDArray[np.float64]) -> None:
    filters, air = wind.filters, wind.velocity
    if draws.shape[0] == 0:
        return
    for i in range(filters.shape[1]):
        x, y, z = velocity[0, i] - air[0, i], velocity[1, i] - air[1, i], velocity[2, i] - air[2, i]
        distance = max(sqrt(x * x + y * y + z * z), SLOWEST) * wind.period
        ratio_u, ratio_w = distance / wind.length_u, distance / wind.length_w
        decay = exp(-ratio_u)
        filters[0, i] = decay * filters[0, i] + sqrt(1 - decay * decay) * draws[0, 0, i]
        filters[1, i], filters[2, i] = _second_order(
            filters[1, i], filters[2, i], ratio_u, draws[0, 1, i], draws[0, 2, i]
        )
        filters[3, i], filters[4, i] = _second_order(
            filters[3, i], filters[4, i], ratio_w, draws[0, 3, i], draws[0, 4, i]
        )
    _write_velocity(wind)
