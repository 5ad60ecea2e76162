"""Noisy sensors on board: what gyroscope, accelerometer, barometer and compass tell each drone, and what it believes.

Gyroscope and accelerometer are read at every step and have white noise, and biases that walk at random from zero, where
a calibration before take-off has left them. Barometer and compass are read with each GPS fix and have white noise; the
fix's velocity has the GPS error of the scenario. `controllers.state_estimation` makes an estimate of it all, which the
controllers then use in place of the truth. The policy goes by GPS alone, as without them.
"""

from __future__ import annotations

from math import atan2, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import Off, implements, kernel, stage
from controllers.geometry import body_axes
from controllers.state_estimation import StateEstimate, correct, design_fixes, integrate
from moflock_mj.effects.fault_injection import has_fix
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.world.constants import GRAVITY
from moflock_mj.world.state import TrueState


class Imu(NamedTuple):
    """Sensors of N drones.

    Attributes:
        gyro_noise: rad/s, deviation of one reading.
        accel_noise: m/s^2, deviation of one reading.
        gyro_walk: rad/s, deviation by which its bias walks in a beat.
        accel_walk: m/s^2, deviation by which its bias walks in a beat.
        baro_noise: m, deviation of one reading.
        compass_noise: rad, deviation of one reading.
        gyro_bias: (3, N), rad/s, body.
        accel_bias: (3, N), m/s^2, body.
        estimate: what the drones believe.
        no_error: (2, N), zeros, in place of the GPS error where the velocity is an estimate.
    """

    gyro_noise: float
    accel_noise: float
    gyro_walk: float
    accel_walk: float
    baro_noise: float
    compass_noise: float
    gyro_bias: NDArray[np.float64]
    accel_bias: NDArray[np.float64]
    estimate: StateEstimate
    no_error: NDArray[np.float64]


def make_imu(scenario: Scenario, step: float, interval: float, world: TrueState) -> Imu | Off:
    """The sensors of a scenario, on drones that know how they start.

    Args:
        scenario: whose `imu` is on or off.
        step: s.
        interval: s, time between two walks of the biases.
        world: where the drones start, level.
    """
    imu, drones = scenario.imu, scenario.drones
    if imu is None:
        return Off()
    gains = design_fixes(
        period=scenario.t_gps,
        gyro_noise=imu.gyro_noise,
        gyro_walk=imu.gyro_walk,
        accel_noise=imu.accel_noise,
        accel_walk=imu.accel_walk,
        velocity_noise=sqrt(scenario.sigma_inner),
        height_noise=imu.baro_noise,
        heading_noise=imu.compass_noise,
    )
    qpos, qvel = np.zeros((drones, 7)), np.zeros((drones, 6))
    qpos[:, 2], qpos[:, 3], qvel[:, :3] = world.position[2], 1, world.velocity.T
    return Imu(
        gyro_noise=imu.gyro_noise / sqrt(step),
        accel_noise=imu.accel_noise / sqrt(step),
        gyro_walk=imu.gyro_walk * sqrt(interval),
        accel_walk=imu.accel_walk * sqrt(interval),
        baro_noise=imu.baro_noise,
        compass_noise=imu.compass_noise,
        gyro_bias=np.zeros((3, drones)),
        accel_bias=np.zeros((3, drones)),
        estimate=StateEstimate(step, GRAVITY, gains, qpos, qvel, np.zeros((3, drones)), np.zeros(drones)),
        no_error=np.zeros((2, drones)),
    )


@stage
def estimated(
    imu: NamedTuple, qpos: NDArray[np.float64], qvel: NDArray[np.float64], velocity_error: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """What the controllers go by.

    Args:
        imu: Sensors, or Off where drones know the truth but for the GPS error of their velocity.
        qpos: (N, 7), the truth.
        qvel: (N, 6), the truth.
        velocity_error: (2, N), m/s, GPS error.

    Returns:
        qpos and qvel as believed, and the error that is to be added to the horizontal velocity.
    """
    return qpos, qvel, velocity_error


@stage
def walk_biases(imu: NamedTuple, draws: NDArray[np.float64]) -> None:
    """Let the biases walk for a beat. draws: (1, 6, N), N(0, 1)."""


@stage
def read_imu(
    imu: NamedTuple,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    qacc: NDArray[np.float64],
    draws: NDArray[np.float32],
    k: int,
) -> None:
    """Read gyroscopes and accelerometers after a step.

    Args:
        imu: the beliefs in it move on.
        qpos: (N, 7), the truth.
        qvel: (N, 6), the truth.
        qacc: (N, 6), the first three m/s^2, world: of the step before.
        draws: (steps, 6, N), uniform in [0, 1).
        k: the step.
    """


@stage
def correct_with_barometer_and_compass(
    imu: NamedTuple,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    draws: NDArray[np.float64],
    faults: NamedTuple,
) -> None:
    """Correct the beliefs by GPS velocity, barometer and compass.

    Args:
        imu: the beliefs in it are corrected.
        qpos: (N, 7), the truth.
        qvel: (N, 6), the truth.
        velocity_error: (2, N), m/s, GPS error.
        draws: (1, 2, N), N(0, 1).
        faults: say who has no GPS velocity.
    """


@implements(estimated, Imu)
def _estimate(
    imu: Imu,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    return imu.estimate.qpos, imu.estimate.qvel, imu.no_error


@implements(walk_biases, Imu)
def _walk(imu: Imu, draws: NDArray[np.float64]) -> None:
    for axis in range(3):
        for i in range(draws.shape[2]):
            imu.gyro_bias[axis, i] += imu.gyro_walk * draws[0, axis, i]
            imu.accel_bias[axis, i] += imu.accel_walk * draws[0, 3 + axis, i]


@kernel
def read_inertial(
    imu: Imu,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    qacc: NDArray[np.float64],
    draws: NDArray[np.float32],
    k: int,
) -> None:
    """As `read_imu`: body rates, and R^T (acceleration - gravity), with noise and bias.

    The noise is uniform, of the deviation asked for: four times as fast to draw as a normal one, and no different after
    the few steps over which it is summed up before it does anything.
    """
    gyro, accel = sqrt(12.0) * imu.gyro_noise, sqrt(12.0) * imu.accel_noise
    gyro_bias, accel_bias = imu.gyro_bias, imu.accel_bias
    for i in range(qpos.shape[0]):
        xx, xy, xz, yx, yy, yz, zx, zy, zz = body_axes(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6])
        ax, ay, az = qacc[i, 0], qacc[i, 1], qacc[i, 2] + GRAVITY
        integrate(
            imu.estimate,
            i,
            qvel[i, 3] + gyro_bias[0, i] + gyro * (draws[k, 0, i] - 0.5),
            qvel[i, 4] + gyro_bias[1, i] + gyro * (draws[k, 1, i] - 0.5),
            qvel[i, 5] + gyro_bias[2, i] + gyro * (draws[k, 2, i] - 0.5),
            xx * ax + yx * ay + zx * az + accel_bias[0, i] + accel * (draws[k, 3, i] - 0.5),
            xy * ax + yy * ay + zy * az + accel_bias[1, i] + accel * (draws[k, 4, i] - 0.5),
            xz * ax + yz * ay + zz * az + accel_bias[2, i] + accel * (draws[k, 5, i] - 0.5),
        )


@implements(read_imu, Imu)
def _read_imu(
    imu: Imu,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    qacc: NDArray[np.float64],
    draws: NDArray[np.float32],
    k: int,
) -> None:
    read_inertial(imu, qpos, qvel, qacc, draws, k)


@implements(correct_with_barometer_and_compass, Imu)
def _correct_with_barometer_and_compass(
    imu: Imu,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    draws: NDArray[np.float64],
    faults: NamedTuple,
) -> None:
    estimated_velocity = imu.estimate.qvel
    for i in range(qpos.shape[0]):
        xx, _, _, yx, _, _, _, _, _ = body_axes(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6])
        fixed = has_fix(faults, i)
        correct(
            imu.estimate,
            i,
            qvel[i, 0] + velocity_error[0, i] if fixed else estimated_velocity[i, 0],
            qvel[i, 1] + velocity_error[1, i] if fixed else estimated_velocity[i, 1],
            qpos[i, 2] + imu.baro_noise * draws[0, 0, i],
            atan2(yx, xx) + imu.compass_noise * draws[0, 1, i],
        )
