"""The target-tracking policy: flocking, and a weak pull towards a target and towards the local centre of the flock.

Source: the target tracking of Bansal, Sethi, Anicho and Nagar, section Results, and of their simulator MOflock.
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
"""m/s, the most that target and middle together add to a drone's velocity."""

REACHED = 2.0
"""m, a target nearer than this no longer pulls."""

LOOSE = 40.0
"""m, a drone farther than this from the middle of those it hears is pulled back to it."""


class TargetTrackingParams(NamedTuple):
    """Parameters of flocking around a target.

    Attributes:
        base: the 12 parameters of flocking.
        target_x: m, world.
        target_y: m, world.
    """

    base: VasarhelyiParams
    target_x: float
    target_y: float


@hot_kernel
def _middle(observation: Observation, i: int) -> tuple[float, float]:
    """Centre of mass of drone i and of those it hears, m, world."""
    x, y = observation.own_position[0, i], observation.own_position[1, i]
    for k in range(observation.neighbour_count[i]):
        j = observation.neighbours[i, k]
        x += observation.received_position[0, j]
        y += observation.received_position[1, j]
    together = observation.neighbour_count[i] + 1
    return x / together, y / together


@hot_kernel
def _towards(x: float, y: float, beyond: float) -> tuple[float, float]:
    """A velocity of `PULL` along (x, y), m; none if that is not farther than `beyond`."""
    if x * x + y * y <= beyond * beyond:
        return 0.0, 0.0
    scale = PULL / np.sqrt(x * x + y * y)
    return scale * x, scale * y


@implements(desired_velocity, TargetTrackingParams)
def target_tracking_policy(
    params: TargetTrackingParams, limits: SpeedLimits, observation: Observation, out: NDArray[np.float64]
) -> None:
    """Desired velocity of each drone: what the flock wants + the pull, at most `PULL`, cut to v_max.

    Args:
        params: the flock's parameters and the target.
        limits: speeds of the scenario, m/s.
        observation: what each drone knows.
        out: (2, N), m/s, world; written.
    """
    for i in range(out.shape[1]):
        x, y = observation.own_position[0, i], observation.own_position[1, i]
        middle_x, middle_y = _middle(observation, i)
        target_x, target_y = _towards(params.target_x - x, params.target_y - y, REACHED)
        back_x, back_y = _towards(middle_x - x, middle_y - y, LOOSE)
        pull_x, pull_y = clip_length(target_x + back_x, target_y + back_y, PULL)
        want_x, want_y = vasarhelyi_velocity(params.base, limits, observation, i)
        out[0, i], out[1, i] = clip_length(want_x + pull_x, want_y + pull_y, limits.v_max)


decide = entry_kernel(target_tracking_policy)
"""`target_tracking_policy`, compiled, for callers outside a compiled flight."""


_REACH = 1e4
"""m, bound of the target's coordinates."""

TARGET_TRACKING = PolicySpec(
    name="target_tracking",
    params=TargetTrackingParams,
    parameters=(
        *VASARHELYI.parameters,
        Parameter("target_x", "m", "x of the target", -_REACH, _REACH),
        Parameter("target_y", "m", "y of the target", -_REACH, _REACH),
    ),
    interaction_range=lambda params, v_flock: VASARHELYI.interaction_range(params.base, v_flock),
    checks=lambda params, conditions: VASARHELYI.checks(params.base, conditions),
)
