"""Reynolds' policy: separation, cohesion and alignment as mean velocities over the nearest neighbours.

Source: Reynolds 1987, Flocks, herds and schools; as velocity commands, as in Schilling et al. 2019 (IEEE RA-L 4(3)) and
Hauert et al. 2011 (IROS). Alignment uses relative velocities, so that a common heading is a fixed point. Walls act by
shill agents, as in Vasarhelyi's policy.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import entry_kernel, hot_kernel, implements
from controllers.geometry import clip_length
from controllers.policies.interface import Observation, Parameter, PolicySpec, SpeedLimits, desired_velocity
from controllers.policies.shill import add_walls

NEIGHBOURS = 7
"""Number of nearest neighbours in the mean (Ballerini et al. 2008 find 6 to 7 for starlings)."""

CLOSEST = 0.1
"""Lower bound of the distance to a neighbour, m, which keeps separation finite."""


class ReynoldsParams(NamedTuple):
    """Parameters of Reynolds' policy.

    Attributes:
        k_sep: gain of separation, m^2/s.
        k_coh: gain of cohesion, 1/s.
        k_align: gain of alignment, 1.
        r0_shill: distance from the wall at which a drone stops, m.
        v_shill: speed of the shill agents, m/s.
        a_shill: acceleration of the braking curve of walls, m/s^2.
        p_shill: slope of the braking curve of walls, 1/s.
        c_shill: gain of walls, 1.
    """

    k_sep: float
    k_coh: float
    k_align: float
    r0_shill: float
    v_shill: float
    a_shill: float
    p_shill: float
    c_shill: float


@hot_kernel
def _next_nearest(observation: Observation, i: int, beyond_sq: float, after: int) -> tuple[int, float]:
    """Index of the next nearest neighbour in drone i's list, or -1, and its squared distance, m^2.

    Neighbours are ordered by distance, then by index. The next one is the first after (beyond_sq, after).
    """
    found, nearest_sq = -1, inf
    for k in range(observation.neighbour_count[i]):
        j = observation.neighbours[i, k]
        rx = observation.received_position[0, j] - observation.own_position[0, i]
        ry = observation.received_position[1, j] - observation.own_position[1, i]
        distance_sq = rx * rx + ry * ry
        if (distance_sq > beyond_sq or (distance_sq == beyond_sq and k > after)) and distance_sq < nearest_sq:
            found, nearest_sq = k, distance_sq
    return found, nearest_sq


@hot_kernel
def _flock_velocity(
    params: ReynoldsParams, limits: SpeedLimits, observation: Observation, i: int
) -> tuple[float, float]:
    """Desired velocity of drone i without walls, before it is limited to v_max, m/s."""
    vx, vy = observation.own_velocity[0, i], observation.own_velocity[1, i]
    sum_x, sum_y, count = 0.0, 0.0, 0
    index, distance_sq = -1, -1.0
    while count < NEIGHBOURS:
        index, distance_sq = _next_nearest(observation, i, distance_sq, index)
        if index < 0:
            break
        j = observation.neighbours[i, index]
        rx = observation.received_position[0, j] - observation.own_position[0, i]
        ry = observation.received_position[1, j] - observation.own_position[1, i]
        pull = params.k_coh - params.k_sep / max(distance_sq, CLOSEST * CLOSEST)
        sum_x += pull * rx + params.k_align * (observation.received_velocity[0, j] - vx)
        sum_y += pull * ry + params.k_align * (observation.received_velocity[1, j] - vy)
        count += 1
    speed = sqrt(vx * vx + vy * vy)
    cruise = limits.v_flock / speed if speed > 0 else 0.0
    share = 1 / max(count, 1)
    return cruise * vx + share * sum_x, cruise * vy + share * sum_y


@implements(desired_velocity, ReynoldsParams)
def reynolds_policy(
    params: ReynoldsParams, limits: SpeedLimits, observation: Observation, out: NDArray[np.float64]
) -> None:
    """Desired velocity of each drone, limited to v_max.

    Args:
        params: the policy's parameters.
        limits: speed limits of the scenario, m/s.
        observation: observations of all drones.
        out: (2, N), desired velocities, m/s, world; written.
    """
    for i in range(out.shape[1]):
        desired_x, desired_y = _flock_velocity(params, limits, observation, i)
        desired_x, desired_y = add_walls(params, observation, i, desired_x, desired_y)
        out[0, i], out[1, i] = clip_length(desired_x, desired_y, limits.v_max)


decide = entry_kernel(reynolds_policy)
"""`reynolds_policy`, compiled, for callers outside a compiled flight."""


def interaction_range(params: ReynoldsParams, v_flock: float) -> float:  # noqa: ARG001
    """1.5 times the distance of two drones at rest, m: drones closer than this form a cluster."""
    return 1.5 * sqrt(params.k_sep / params.k_coh)


REYNOLDS = PolicySpec(
    name="reynolds",
    params=ReynoldsParams,
    parameters=(
        Parameter("k_sep", "m^2/s", "gain of separation", 20.0, 500.0, positive=True),
        Parameter("k_coh", "1/s", "gain of cohesion", 0.005, 0.1, positive=True),
        Parameter("k_align", "1", "gain of alignment", 0.1, 1.5),
        Parameter("r0_shill", "m", "distance from the wall at which a drone stops", -10.0, 5.0),
        Parameter("v_shill", "m/s", "speed of the shill agents", 10.0, 15.0),
        Parameter("a_shill", "m/s^2", "acceleration of the braking curve of walls", 1.54, 6.55, positive=True),
        Parameter("p_shill", "1/s", "slope of the braking curve of walls", 0.48, 9.96, positive=True),
        Parameter("c_shill", "1", "gain of walls", 0.3, 1.0),
    ),
    interaction_range=interaction_range,
)
