"""The flocking policy: 12 parameters, and what a drone senses, to its desired velocity.

Source: Vasarhelyi et al., Optimized flocking of autonomous drones in confined environments, Science Robotics 3 (2018),
with the shill gain of Bansal, Sethi, Anicho and Nagar (`c_shill`). Symbols are theirs.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import entry_kernel, hot_kernel, implements, kernel
from controllers.geometry import clip_length
from controllers.policies.braking import braking_curve
from controllers.policies.interface import Observation, SpeedLimits, desired_velocity


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
        r0_shill: distance before the wall at which a drone should have stopped, m.
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
    """Velocity away from a neighbour at (rx, ry), m."""
    distance_sq = rx * rx + ry * ry
    if distance_sq >= params.r0_rep * params.r0_rep or distance_sq == 0:
        return 0.0, 0.0
    distance = sqrt(distance_sq)
    gain = -min(params.p_rep * (params.r0_rep - distance), v_rep_max) / distance
    return gain * rx, gain * ry


@kernel
def _alignment(params: VasarhelyiParams, rx: float, ry: float, vx: float, vy: float) -> tuple[float, float]:
    """Velocity towards that of a neighbour at (rx, ry), m, which moves at (vx, vy), m/s, as seen from the drone."""
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


@kernel
def _shill(
    params: VasarhelyiParams, distance: float, normal_x: float, normal_y: float, vx: float, vy: float
) -> tuple[float, float]:
    """Velocity towards that of a wall's shill agent, for a drone `distance` metres before it that moves at (vx, vy)."""
    ex, ey = params.v_shill * normal_x - vx, params.v_shill * normal_y - vy
    difference_sq = ex * ex + ey * ey
    tolerated = braking_curve(distance - params.r0_shill, params.a_shill, params.p_shill)
    if difference_sq <= tolerated * tolerated:
        return 0.0, 0.0
    difference = sqrt(difference_sq)
    gain = params.c_shill * (difference - tolerated) / difference
    return gain * ex, gain * ey


@hot_kernel
def vasarhelyi_velocity(
    params: VasarhelyiParams, limits: SpeedLimits, observation: Observation, i: int
) -> tuple[float, float]:
    """What drone i wants before the cut to v_max, m/s, world: self-propulsion + repulsion + alignment + walls.

    A policy that adds to flocking calls this too, and cuts afterwards.

    Args:
        params: the 12 parameters.
        limits: speeds of the scenario, m/s.
        observation: what each drone knows.
        i: number of the drone.
    """
    x, y = observation.own_position[0, i], observation.own_position[1, i]
    vx, vy = observation.own_velocity[0, i], observation.own_velocity[1, i]
    speed = sqrt(vx * vx + vy * vy)
    cruise = limits.v_flock / speed if speed > 0 else 0.0
    want_x, want_y = cruise * vx, cruise * vy
    for k in range(observation.neighbour_count[i]):
        j = observation.neighbours[i, k]
        rx, ry = observation.received_position[0, j] - x, observation.received_position[1, j] - y
        rep_x, rep_y = _repulsion(params, limits.v_rep_max, rx, ry)
        frict_x, frict_y = _alignment(
            params, rx, ry, observation.received_velocity[0, j] - vx, observation.received_velocity[1, j] - vy
        )
        want_x += rep_x + frict_x
        want_y += rep_y + frict_y
    for wall in range(observation.wall_distance.shape[0]):
        normal_x, normal_y = observation.wall_normal[wall, 0, i], observation.wall_normal[wall, 1, i]
        shill_x, shill_y = _shill(params, observation.wall_distance[wall, i], normal_x, normal_y, vx, vy)
        want_x += shill_x
        want_y += shill_y
    return want_x, want_y


@implements(desired_velocity, VasarhelyiParams)
def vasarhelyi_policy(
    params: VasarhelyiParams, limits: SpeedLimits, observation: Observation, out: NDArray[np.float64]
) -> None:
    """Desired velocity of each drone: `vasarhelyi_velocity`, cut to v_max.

    Args:
        params: the 12 parameters.
        limits: speeds of the scenario, m/s.
        observation: what each drone knows.
        out: (2, N), m/s, world; written.
    """
    for i in range(out.shape[1]):
        want_x, want_y = vasarhelyi_velocity(params, limits, observation, i)
        out[0, i], out[1, i] = clip_length(want_x, want_y, limits.v_max)


decide = entry_kernel(vasarhelyi_policy)
"""`vasarhelyi_policy`, compiled, for callers outside a compiled flight: a live deployment, a notebook, a test."""
