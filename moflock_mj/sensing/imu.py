"""On-board sensors: gyroscope, accelerometer, barometer and compass, and the state estimates from them.

Gyroscope and accelerometer are read at every step. They have white noise, and biases that start at zero, as after a
calibration, and follow a random walk. Barometer and compass are read with each GPS fix and have white noise. The
velocity of a fix has the GPS error of the scenario. `controllers.state_estimation` estimates the state, which the
controllers use instead of the true state. The policy uses GPS alone, as without these sensors.
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
    """Sensors and state estimates of N drones.

    Attributes:
        gyro_noise: standard deviation of a gyroscope reading, rad/s.
        accel_noise: standard deviation of an accelerometer reading, m/s^2.
        gyro_walk: standard deviation of the change of the gyroscope bias per interval, rad/s.
        accel_walk: standard deviation of the change of the accelerometer bias per interval, m/s^2.
        baro_noise: standard deviation of a barometer reading, m.
        compass_noise: standard deviation of a compass reading, rad.
        gyro_bias: (3, N), gyroscope bias, rad/s, body.
        accel_bias: (3, N), accelerometer bias, m/s^2, body.
        estimate: state estimates.
        no_error: (2, N), zeros, instead of the GPS error of a measured velocity.
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
    """Create the sensors of a scenario with exact initial estimates, or Off without an IMU model.

    Args:
        scenario: the scenario.
        step: integration step, s.
        interval: interval between two updates of the biases, s.
        world: initial state, with level drones.
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
    """State feedback of the controllers; without an IMU model the true state with the GPS error of the velocity.

    Args:
        imu: the sensors, or Off.
        qpos: (N, 7), true position and attitude.
        qvel: (N, 6), true velocities.
        velocity_error: (2, N), GPS velocity error, m/s.

    Returns:
        qpos and qvel for the controllers, and the error to add to the horizontal velocity.
    """
    return qpos, qvel, velocity_error


@stage
def walk_biases(imu: NamedTuple, draws: NDArray[np.float64]) -> None:
    """Advance the random walk of the biases by one interval; no effect without an IMU model.

    Args:
        imu: the sensors; the biases are updated.
        draws: (1, 6, N), N(0, 1).
    """


@stage
def read_imu(
    imu: NamedTuple,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    qacc: NDArray[np.float64],
    draws: NDArray[np.float32],
    k: int,
) -> None:
    """Read gyroscopes and accelerometers after a step, and advance the estimates; no effect without an IMU model.

    Args:
        imu: the sensors; the estimates are updated.
        qpos: (N, 7), true position and attitude.
        qvel: (N, 6), true velocities.
        qacc: (N, 6), accelerations of the previous step, the first three m/s^2, world.
        draws: (steps, 6, N), uniform in [0, 1).
        k: index of the step.
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
    """Correct the estimates by GPS velocity, barometer and compass; no effect without an IMU model.

    Args:
        imu: the sensors; the estimates are corrected.
        qpos: (N, 7), true position and attitude.
        qvel: (N, 6), true velocities.
        velocity_error: (2, N), GPS velocity error, m/s.
        draws: (1, 2, N), N(0, 1).
        faults: fault schedule, or Off; a drone without GPS has no velocity correction.
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
    """Measure body rates and R^T (acceleration - gravity) with noise and bias, and integrate them; see `read_imu`.

    The noise is uniform with the given standard deviation, which is four times as fast to draw as normal noise. The
    estimator sums it over several steps, after which the distributions hardly differ.
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
        has_gps = has_fix(faults, i)
        correct(
            imu.estimate,
            i,
            qvel[i, 0] + velocity_error[0, i] if has_gps else estimated_velocity[i, 0],
            qvel[i, 1] + velocity_error[1, i] if has_gps else estimated_velocity[i, 1],
            qpos[i, 2] + imu.baro_noise * draws[0, 0, i],
            atan2(yx, xx) + imu.compass_noise * draws[0, 1, i],
        )
