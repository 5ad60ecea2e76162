"""The block that the two dynamics exchange: from a desired velocity to motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import stage
from moflock_mj.world.state import TrueState


class Noise(NamedTuple):
    """Random numbers for one beat; the first axis is of length 0 where a flight takes none of a kind.

    Attributes:
        outer: (steps, 2, N), N(0, 1), of the outer noise.
        gust: (1, 5, N), N(0, 1), of gusts.
        inertial: (steps, 6, N), uniform in [0, 1), of gyroscope and accelerometer.
        walk: (1, 6, N), N(0, 1), of their biases.
    """

    outer: NDArray[np.float64]
    gust: NDArray[np.float64]
    inertial: NDArray[np.float32]
    walk: NDArray[np.float64]


@stage
def advance(
    dynamics: NamedTuple,
    world: TrueState,
    desired: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    noise: Noise,
    steps: int,
) -> None:
    """Move all drones by one beat.

    Args:
        dynamics: the dynamics.
        world: the true state; written.
        desired: (2, N), m/s, world, the velocity commanded.
        velocity_error: (2, N), m/s, the GPS error in what each drone measures of its own velocity.
        noise: random numbers.
        steps: integration steps of the beat.
    """
    raise NotImplementedError


@stage
def take_fix(dynamics: NamedTuple, velocity_error: NDArray[np.float64], noise: NDArray[np.float64]) -> None:
    """Let each drone correct what it estimates of itself, at every GPS fix.

    Args:
        dynamics: the dynamics.
        velocity_error: (2, N), m/s, the GPS error in what each drone measures of its own velocity.
        noise: (1, 2, N), N(0, 1), of barometer and compass; (0, 2, N) where a flight takes none.
    """


@stage
def write_state(dynamics: NamedTuple, world: TrueState, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> None:
    """Write the whole state as MuJoCo orders it.

    Args:
        dynamics: the dynamics.
        world: the true state.
        qpos: (N, 7), position (m, world) and quaternion w x y z; written.
        qvel: (N, 6), velocity (m/s, world) and body rates (rad/s, body); written.
    """
    raise NotImplementedError
