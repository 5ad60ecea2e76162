"""Vasarhelyi's flocking policy: desired velocity of a drone from its observation and 12 parameters.

Source: Vasarhelyi et al., Optimized flocking of autonomous drones in confined environments, Science Robotics 3 (2018),
with the shill gain of Bansal, Sethi, Anicho and Nagar (`c_shill`). The symbols are those of the papers.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, log10, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import entry_kernel, hot_kernel, implements, kernel
from controllers.geometry import clip_length
from controllers.policies.braking import braking_curve, braking_distance
from controllers.policies.interface import (
    FlightConditions,
    Observation,
    Parameter,
    PolicyCheck,
    PolicySpec,
    SpeedLimits,
    desired_velocity,
)
from controllers.policies.shill import add_walls


class VasarhelyiParams(NamedTuple):
    """The 12 parameters of the policy, in the paper's order.

    Attributes:
        r0_rep: range of repulsion, m.
        p_rep: gain of repulsion, 1/s.
        r0_frict: range of full alignment, beyond r0_rep, m.
        a_frict: acceleration of the alignment's braking curve, m/s^2.
        p_frict: slope of the alignment's braking curve, 1/s.
        v_frict: velocity difference that alignment tolerates, m/s.
        c_frict: gain of alignment, 1.
        r0_shill: distance from the wall at which a drone stops, m.
        v_shill: speed of the shill agents, m/s.
        a_shill: acceleration of the wall's braking curve, m/s^2.
        p_shill: slope of the wall's braking curve, 1/s.
        c_shill: gain of the wall, 1.
    """

    r0_rep: float
    p_rep: float
    r0_frict: float
    a_frict: float
    p_frict: float
    v_frict: float
    c_frict: float
    r0_shill: float
    v_shill: float
    a_shill: float
    p_shill: float
    c_shill: float


@kernel
def _repulsion(params: VasarhelyiParams, v_rep_max: float, rx: float, ry: float) -> tuple[float, float]:
    """Repulsion from a neighbour at relative position (rx, ry), m: velocity, m/s."""
    distance_sq = rx * rx + ry * ry
    if distance_sq >= params.r0_rep * params.r0_rep or distance_sq == 0:
        return 0.0, 0.0
    distance = sqrt(distance_sq)
    gain = -min(params.p_rep * (params.r0_rep - distance), v_rep_max) / distance
    return gain * rx, gain * ry


@kernel
def _alignment(params: VasarhelyiParams, rx: float, ry: float, vx: float, vy: float) -> tuple[float, float]:
    """Alignment with a neighbour at relative position (rx, ry), m, and relative velocity (vx, vy), m/s."""
    difference_sq = vx * vx + vy * vy
    if difference_sq <= params.v_frict * params.v_frict or difference_sq == 0:
        return 0.0, 0.0
    tolerated = params.v_frict
    full_range = params.r0_frict + params.r0_rep
    distance_sq = rx * rx + ry * ry
    if full_range < 0 or distance_sq > full_range * full_range:
        tolerated = max(tolerated, braking_curve(sqrt(distance_sq) - full_range, params.a_frict, params.p_frict))
    difference = sqrt(difference_sq)
    if difference <= tolerated:
        return 0.0, 0.0
    gain = params.c_frict * (difference - tolerated) / difference
    return gain * vx, gain * vy


@hot_kernel
def vasarhelyi_velocity(
    params: VasarhelyiParams, limits: SpeedLimits, observation: Observation, i: int
) -> tuple[float, float]:
    """Desired velocity of drone i before it is limited to v_max, m/s, world.

    It is the sum of self-propulsion, repulsion, alignment and walls. A policy that extends flocking calls this function
    and limits the sum of its own.

    Args:
        params: the 12 parameters.
        limits: speed limits of the scenario, m/s.
        observation: observations of all drones.
        i: number of the drone.
    """
    x, y = observation.own_position[0, i], observation.own_position[1, i]
    vx, vy = observation.own_velocity[0, i], observation.own_velocity[1, i]
    speed = sqrt(vx * vx + vy * vy)
    cruise = limits.v_flock / speed if speed > 0 else 0.0
    desired_x, desired_y = cruise * vx, cruise * vy
    for k in range(observation.neighbour_count[i]):
        j = observation.neighbours[i, k]
        rx, ry = observation.received_position[0, j] - x, observation.received_position[1, j] - y
        rep_x, rep_y = _repulsion(params, limits.v_rep_max, rx, ry)
        frict_x, frict_y = _alignment(
            params, rx, ry, observation.received_velocity[0, j] - vx, observation.received_velocity[1, j] - vy
        )
        desired_x += rep_x + frict_x
        desired_y += rep_y + frict_y
    return add_walls(params, observation, i, desired_x, desired_y)


@implements(desired_velocity, VasarhelyiParams)
def vasarhelyi_policy(
    params: VasarhelyiParams, limits: SpeedLimits, observation: Observation, out: NDArray[np.float64]
) -> None:
    """Desired velocity of each drone: `vasarhelyi_velocity`, limited to v_max.

    Args:
        params: the 12 parameters.
        limits: speed limits of the scenario, m/s.
        observation: observations of all drones.
        out: (2, N), desired velocities, m/s, world; written.
    """
    for i in range(out.shape[1]):
        desired_x, desired_y = vasarhelyi_velocity(params, limits, observation, i)
        out[0, i], out[1, i] = clip_length(desired_x, desired_y, limits.v_max)


decide = entry_kernel(vasarhelyi_policy)
"""`vasarhelyi_policy`, compiled, for callers outside a compiled flight: a live deployment, a notebook, a test."""


def interaction_range(params: VasarhelyiParams, v_flock: float) -> float:
    """r_cluster of the paper, m: r0_rep + r0_frict + the braking distance from v_flock (m/s)."""
    return float(params.r0_rep + params.r0_frict + braking_distance(v_flock, params.a_frict, params.p_frict))


_CHOOSE_ANOTHER = "choose another point: moflock pick, moflock validate"

_OCCUPANCY_MAX = 0.5
"""Largest fraction of the arena that drones r0_rep apart may occupy."""

_GAIN_MARGIN_MIN = 6.0
"""Required gain margin of the loop that keeps two drones apart, dB."""

_PHASE_MARGIN_MIN = 45.0
"""Required phase margin of the same loop, degrees."""


def checks(params: VasarhelyiParams, conditions: FlightConditions) -> Sequence[PolicyCheck]:
    """Check the parameters before a flight: ranges, braking, space, and the stability of repulsion."""
    return [
        *_range_checks(params, conditions),
        *_braking_checks(params, conditions),
        *_space_checks(params, conditions),
        *_loop_checks(params, conditions),
    ]


def _range_checks(params: VasarhelyiParams, conditions: FlightConditions) -> list[PolicyCheck]:
    """Check the order of the ranges of alignment, repulsion and radio."""
    closing = 2 * conditions.v_max * (conditions.delay + conditions.t_gps + conditions.tau)
    return [
        PolicyCheck(
            name="alignment begins outside repulsion",
            good=params.r0_frict >= params.r0_rep,
            value=params.r0_frict,
            unit="m",
            limit=f"r0_frict at least r0_rep, {params.r0_rep:g} m",
            advice=f"drones would be pushed apart before they match speeds: {_CHOOSE_ANOTHER}",
        ),
        PolicyCheck(
            name="repulsion within radio range",
            good=params.r0_rep <= conditions.r_comm,
            value=params.r0_rep,
            unit="m",
            limit=f"r0_rep at most r_comm, {conditions.r_comm:g} m",
            advice="drones cannot avoid drones that are out of radio range: use better radios, or another point",
        ),
        PolicyCheck(
            name="alignment within radio range",
            good=params.r0_frict <= conditions.r_comm,
            value=params.r0_frict,
            unit="m",
            limit=f"r0_frict at most r_comm, {conditions.r_comm:g} m",
            advice="no packets arrive from the outer part of the alignment range: use radios of longer range",
            fatal=False,
        ),
        PolicyCheck(
            name="distance until drones react to each other",
            good=closing <= params.r0_rep,
            value=closing,
            unit="m",
            limit=f"2 v_max (t_del + t_gps + tau) at most r0_rep, {params.r0_rep:g} m",
            advice="two drones that meet close in faster than they react: lower v_max, or choose a point with a larger "
            "r0_rep",
            whole_flock=True,
        ),
    ]


def _braking_checks(params: VasarhelyiParams, conditions: FlightConditions) -> list[PolicyCheck]:
    """Check that the airframe can follow the braking curves."""
    strongest = conditions.a_max
    return [
        PolicyCheck(
            name="braking at walls",
            good=params.a_shill <= strongest,
            value=params.a_shill,
            unit="m/s^2",
            limit=f"a_shill at most {strongest:.3g} m/s^2, the limit of the {conditions.airframe}",
            advice=f"drones would overshoot the wall: {_CHOOSE_ANOTHER}, or use a stronger airframe",
        ),
        PolicyCheck(
            name="braking among drones",
            good=params.a_frict <= 2 * strongest,
            value=params.a_frict,
            unit="m/s^2",
            limit=f"a_frict at most {2 * strongest:.3g} m/s^2: both drones of a pair brake",
            advice=f"two drones that meet could not brake as the policy assumes: {_CHOOSE_ANOTHER}",
        ),
        PolicyCheck(
            name="walls turn the flock",
            good=params.v_shill > conditions.v_flock,
            value=params.v_shill,
            unit="m/s",
            limit=f"v_shill over v_flock, {conditions.v_flock:g} m/s",
            advice="drones would leave the arena: choose a point with a larger v_shill, or lower v_flock",
        ),
    ]


def _space_checks(params: VasarhelyiParams, conditions: FlightConditions) -> list[PolicyCheck]:
    """Check the space in the arena: in hexagonal packing a drone takes sqrt(3)/2 times the distance squared."""
    occupancy = conditions.drones * sqrt(3) / 2 * params.r0_rep**2 / conditions.arena_area
    return [
        PolicyCheck(
            name="space in the arena",
            good=occupancy <= _OCCUPANCY_MAX,
            value=100 * occupancy,
            unit="%",
            limit=f"drones r0_rep apart take at most {100 * _OCCUPANCY_MAX:g} % of the arena",
            advice="fly fewer drones or use a larger arena",
            fatal=occupancy > 1,
            whole_flock=True,
        ),
    ]


def _loop_checks(params: VasarhelyiParams, conditions: FlightConditions) -> list[PolicyCheck]:
    """Check the stability margins of the loop that keeps two drones apart over the radio links.

    Each drone responds to the distance with the gain p_rep (1/s) and the velocity response 1 / (1 + tau s). The age of
    a position is the delay plus, on average, half of an interval of fixes.
    """
    import control  # noqa: PLC0415 - takes most of a second

    delay = conditions.delay + conditions.t_gps / 2
    s = control.tf("s")
    numerator, denominator = control.pade(delay, 6) if delay > 0 else ([1.0], [1.0])
    loop = 2 * params.p_rep / (s * (1 + conditions.tau * s)) * control.tf(numerator, denominator)
    gain, phase, _, _ = map(float, control.margin(loop))
    decibels = 20 * log10(gain) if 0 < gain < inf else inf
    condition = f"with {1e3 * conditions.delay:.0f} ms of delay"
    margins = (("gain", decibels, _GAIN_MARGIN_MIN, "dB"), ("phase", phase, _PHASE_MARGIN_MIN, "degrees"))
    return [
        PolicyCheck(
            name=f"{kind} margin of repulsion {condition}",
            good=value >= minimum,
            value=value,
            unit=unit,
            limit=f"at least {minimum:g} {unit}",
            advice="shorten the delay (radios, rates), or choose a point with a smaller p_rep",
            whole_flock=True,
        )
        for kind, value, minimum, unit in margins
    ]


VASARHELYI = PolicySpec(
    name="vasarhelyi",
    params=VasarhelyiParams,
    parameters=(
        # Bounds: the paper's table of decision variables.
        Parameter("r0_rep", "m", "range of repulsion", 30.8, 51.0),
        Parameter("p_rep", "1/s", "gain of repulsion", 0.02, 0.1),
        Parameter("r0_frict", "m", "range of full alignment, beyond r0_rep", 58.5, 100.0),
        Parameter("a_frict", "m/s^2", "acceleration of the braking curve of alignment", 5.04, 10.0, positive=True),
        Parameter("p_frict", "1/s", "slope of the braking curve of alignment", 0.38, 9.67, positive=True),
        Parameter("v_frict", "m/s", "velocity difference that alignment tolerates", 0.3, 2.7),
        Parameter("c_frict", "1", "gain of alignment", 0.03, 0.22),
        Parameter("r0_shill", "m", "distance from the wall at which a drone stops", -10.0, 0.0),
        Parameter("v_shill", "m/s", "speed of the shill agents", 10.0, 15.0),
        Parameter("a_shill", "m/s^2", "acceleration of the braking curve of walls", 1.54, 6.55, positive=True),
        Parameter("p_shill", "1/s", "slope of the braking curve of walls", 0.48, 9.96, positive=True),
        Parameter("c_shill", "1", "gain of walls", 0.3, 1.0),
    ),
    interaction_range=interaction_range,
    checks=checks,
)
