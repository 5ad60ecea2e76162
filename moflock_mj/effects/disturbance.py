"""Velocity disturbance: white-noise force on rigid bodies, with the velocity increments of RobotSim's point masses.

It is RobotSim's outer noise. Wind replaces it.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.airframe import Airframe
from controllers.compiling import Off, hot_stage, implements
from moflock_mj.scenario.scenario import Scenario


class VelocityDisturbance(NamedTuple):
    """White-noise force on the bodies.

    Attributes:
        force: standard deviation of the force in one step, N.
    """

    force: float


def make_disturbance(scenario: Scenario, airframe: Airframe, step: float) -> VelocityDisturbance | Off:
    """Create the velocity disturbance of a scenario, for steps of `step`, s."""
    if scenario.wind is not None:
        return Off()
    return VelocityDisturbance(airframe.mass * sqrt(2 * scenario.sigma_outer / step))


@hot_stage
def draw_force(outer: NamedTuple, noise: NDArray[np.float64], k: int, i: int) -> tuple[float, float]:
    """Disturbance force on body i in step k, N, x and y; zero if off."""
    return 0.0, 0.0


@hot_stage
def outer_force(outer: NamedTuple) -> float:
    """Standard deviation of the disturbance force, N; zero if off."""
    return 0.0


@implements(draw_force, VelocityDisturbance)
def _draw_force(outer: VelocityDisturbance, noise: NDArray[np.float64], k: int, i: int) -> tuple[float, float]:
    return outer.force * noise[k, 0, i], outer.force * noise[k, 1, i]


@implements(outer_force, VelocityDisturbance)
def _outer_force(outer: VelocityDisturbance) -> float:
    return outer.force
