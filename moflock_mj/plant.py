"""The block that the two dynamics exchange: from a desired velocity to motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import stage
from moflock_mj.world import World


@stage
def advance(
    plant: NamedTuple,
    world: World,
    desired: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    noise: NDArray[np.float64],
) -> None:
    """Move all drones by some integration steps; chosen by the type of `plant`.

    Args:
        plant: the dynamics.
        world: the true state; written.
        desired: (2, N), m/s, world, the velocity commanded.
        velocity_error: (2, N), m/s, the GPS error in what each drone measures of its own velocity.
        noise: (steps, 2, N), N(0, 1); as many steps are made.
    """


@stage
def write_state(plant: NamedTuple, world: World, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> None:
    """Write the whole state as MuJoCo orders it; chosen by the type of `plant`.

    Args:
        plant: the dynamics.
        world: the true state.
        qpos: (N, 7), position (m, world) and quaternion w x y z; written.
        qvel: (N, 6), velocity (m/s, world) and body rates (rad/s, body); written.
    """
