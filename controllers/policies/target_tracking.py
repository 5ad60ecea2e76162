"""Target-tracking policy: flocking, and a weak attraction to a target and to the local centre of the flock.

Source: Bansal, Sethi, Anicho and Nagar, section Results, and their simulator MOflock.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import entry_kernel, hot_kernel, implements
from controllers.geometry import clip_length
from controllers.policies.interface import Observation, Parameter, PolicySpec, SpeedLimits, desired_velocity
from controllers.policies.vasarhelyi import VASARHELYI, VasarhelyiParams, vasarhelyi_velocity

PULL = 2.0
"""Largest velocity that target and local centre members add, m/s."""

REACHED = 2.0
"""Distance within which the target attracts no longer, m."""

LOOSE = 40.0
"""Distance from the local centre beyond which the centre attracts, m."""


class TargetTrackingParams(NamedTuple):
    """Parameters of the target-tracking policy.

    Attributes:
        base: the 12 parameters of flocking.
        target_x: x of the target, m, world.
        target_y: y of the target, m, world.
    """

    base: VasarhelyiParams
    target_x: float
    target_y: float


@hot_kernel
def _local_centre(observation: Observation, i: int) -> tuple[float, float]:
    """Centroid of drone i and its neighbours, m, world."""
    x, y = observation.own_position[0, i], observation.own_position[1, i]
    for k in range(observation.neighbour_count[i]):
        j = observation.neighbours[i, k]
        x += observation.received_position[0, j]
        y += observation.received_position[1, j]
    members = observation.neighbour_count[i] + 1
    return x / members, y / members


@hot_kernel
def _attraction(x: float, y: float, beyond: float) -> tuple[float, float]:
    """Velocity of `PULL` along (x, y), m; zero within a distance of `beyond`, m."""
    if x * x + y * y <= beyond * beyond:
        return 0.0, 0.0
    scale = PULL / np.sqrt(x * x + y * y)
    return scale * x, scale * y


@implements(desired_velocity, TargetTrackingParams)
def target_tracking_policy(
    params: TargetTrackingParams, limits: SpeedLimits, observation: Observation, out: NDArray[np.float64]
) -> None:
    """Desired velocity of each drone: flocking plus attraction (at most `PULL`), limited to v_max.

    Args:
        params: the flock's parameters and the target.
        limits: speed limits of the scenario, m/s.
        observation: observations of all drones.
        out: (2, N), desired velocities, m/s, world; written.
    """
    for i in range(out.shape[1]):
        x, y = observation.own_position[0, i], observation.own_position[1, i]
        centre_x, centre_y = _local_centre(observation, i)
        target_x, target_y = _attraction(params.target_x - x, params.target_y - y, REACHED)
        back_x, back_y = _attraction(centre_x - x, centre_y - y, LOOSE)
        pull_x, pull_y = clip_length(target_x + back_x, target_y + back_y, PULL)
        flock_x, flock_y = vasarhelyi_velocity(params.base, limits, observation, i)
        out[0, i], out[1, i] = clip_length(flock_x + pull_x, flock_y + pull_y, limits.v_max)


decide = entry_kernel(target_tracking_policy)
"""`target_tracking_policy`, compiled, for callers outside a compiled flight."""


_MAX_COORDINATE = 1e4
"""Largest absolute coordinate of a target, m."""

TARGET_TRACKING = PolicySpec(
    name="target_tracking",
    params=TargetTrackingParams,
    parameters=(
        *VASARHELYI.parameters,
        Parameter("target_x", "m", "x of the target", -_MAX_COORDINATE, _MAX_COORDINATE),
        Parameter("target_y", "m", "y of the target", -_MAX_COORDINATE, _MAX_COORDINATE),
    ),
    interaction_range=lambda params, v_flock: VASARHELYI.interaction_range(params.base, v_flock),
    checks=lambda params, conditions: VASARHELYI.checks(params.base, conditions),
)
