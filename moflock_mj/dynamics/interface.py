"""Interface of the dynamics, from a desired velocity to motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import stage
from moflock_mj.world.state import TrueState


class Noise(NamedTuple):
    """Random numbers for one control interval; the first axis has length 0 for a kind that the flight does not use.

    Attributes:
        outer: (steps, 2, N), N(0, 1), for the velocity disturbance.
        gust: (1, 5, N), N(0, 1), for gusts.
        inertial: (steps, 6, N), uniform in [0, 1), for gyroscope and accelerometer.
        walk: (1, 6, N), N(0, 1), for their biases.
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
    """Advance all drones by one control interval.

    Args:
        dynamics: the dynamics.
        world: the true state; written.
        desired: (2, N), commanded velocity, m/s, world.
        velocity_error: (2, N), GPS error of each drone's measured velocity, m/s.
        noise: random numbers of the interval.
        steps: integration steps of the interval.
    """
    raise NotImplementedError


@stage
def take_fix(dynamics: NamedTuple, velocity_error: NDArray[np.float64], noise: NDArray[np.float64]) -> None:
    """Correct the state estimate of each drone at a GPS fix.

    Args:
        dynamics: the dynamics.
        velocity_error: (2, N), GPS error of each drone's measured velocity, m/s.
        noise: (1, 2, N), N(0, 1), for barometer and compass; (0, 2, N) without them.
    """


@stage
def write_state(dynamics: NamedTuple, world: TrueState, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> None:
    """Write the complete state in MuJoCo's order.

    Args:
        dynamics: the dynamics.
        world: the true state.
        qpos: (N, 7), position (m, world) and quaternion w x y z; written.
        qvel: (N, 6), velocity (m/s, world) and body rates (rad/s, body); written.
    """
    raise NotImplementedError
