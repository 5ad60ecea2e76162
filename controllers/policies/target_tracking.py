"""The loitering policy: flocking, and a gentle pull towards a target and towards the flock's local middle.

Source: the target tracking of Bansal, Sethi, Anicho and Nagar, section Results, and of their simulator MOflock.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import entry_kernel, hot_kernel, implements
from controllers.geometry import clip_length
from controllers.policies.interface import Observation, SpeedLimits, desired_velocity
from controllers.policies.vasarhelyi import VasarhelyiParams, vasarhelyi_velocity

PULL = 2.0
"""m/s, the most that target and middle together add to a drone's velocity."""

REACHED = 2.0
"""m, a target nearer than this no longer pulls."""

LOOSE = 40.0
"""m, a drone farther than this from the middle of those it hears is pulled back to it."""


class TargetTrackingParams(NamedTuple):
    """The flocking policy's 12 parameters, by the same names and in the same order, and where the target is.

    Attributes:
        r0_rep: and the 11 that follow, see `VasarhelyiParams`.
        target_x: m, world; so is target_y.
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
    target_x: float
    target_y: float

    @classmethod
    def of(cls, params: VasarhelyiParams, target: tuple[float, float]) -> TargetTrackingParams:
        """A flock's parameters and a target at (x, y), m."""
        return cls(*params, float(target[0]), float(target[1]))


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
    flocking = VasarhelyiParams(*params[:12])
    for i in range(out.shape[1]):
        x, y = observation.own_position[0, i], observation.own_position[1, i]
        middle_x, middle_y = _middle(observation, i)
        target_x, target_y = _towards(params.target_x - x, params.target_y - y, REACHED)
        back_x, back_y = _towards(middle_x - x, middle_y - y, LOOSE)
        pull_x, pull_y = clip_length(target_x + back_x, target_y + back_y, PULL)
        want_x, want_y = vasarhelyi_velocity(flocking, limits, observation, i)
        out[0, i], out[1, i] = clip_length(want_x + pull_x, want_y + pull_y, limits.v_max)


decide = entry_kernel(target_tracking_policy)
"""`target_tracking_policy`, compiled, for callers outside a compiled flight."""
