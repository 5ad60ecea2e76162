"""Point-mass dynamics: RobotSim's robot model, a first-order velocity response with bounded acceleration and noise."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import implements
from moflock_mj.plant import advance, write_state
from moflock_mj.world import World


class PointMass(NamedTuple):
    """Figures of the scenario that a point mass obeys.

    Attributes:
        step: s.
        tau: s, time constant of the velocity.
        a_max: m/s^2, bound of the acceleration, before noise.
        sigma_outer: m^2/s^3, strength of the outer noise.
    """

    step: float
    tau: float
    a_max: float
    sigma_outer: float


@implements(advance, PointMass)
def advance_point_masses(
    plant: PointMass,
    world: World,
    desired: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    noise: NDArray[np.float64],
) -> None:
    """Euler-Maruyama steps of v' = clip((v_desired - v_measured) / tau, a_max) + outer noise, x' = v."""
    step, kick = plant.step, sqrt(2 * plant.sigma_outer * plant.step)
    x, y, _ = world.position
    vx, vy, _ = world.velocity
    for k in range(noise.shape[0]):
        noise_x, noise_y = noise[k]
        for i in range(x.size):
            ax = (desired[0, i] - vx[i] - velocity_error[0, i]) / plant.tau
            ay = (desired[1, i] - vy[i] - velocity_error[1, i]) / plant.tau
            gain = step * plant.a_max / max(sqrt(ax * ax + ay * ay), plant.a_max)
            x[i] += step * vx[i]
            y[i] += step * vy[i]
            vx[i] += gain * ax + kick * noise_x[i]
            vy[i] += gain * ay + kick * noise_y[i]


@implements(write_state, PointMass)
def write_point_masses(plant: PointMass, world: World, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> None:  # noqa: ARG001
    for i in range(qpos.shape[0]):
        for axis in range(3):
            qpos[i, axis] = world.position[axis, i]
            qvel[i, axis] = world.velocity[axis, i]
        qpos[i, 3] = 1.0
