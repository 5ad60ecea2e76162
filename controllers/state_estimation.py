"""State estimation: attitude, body rates, velocity and height from inertial sensors and GPS fixes.

The estimator is a complementary filter. The integrals of gyroscope and accelerometer are accurate for seconds, and
fixes correct their drift. The velocity of the fixes also makes the tilt observable, because a tilt error turns gravity
into a growing velocity error (M.-D. Hua: Attitude estimation for accelerated vehicles using GPS/INS measurements,
Control Engineering Practice 18(7), 2010). The gains are those of the stationary Kalman filter of the errors, linearised
about level flight, and follow from the sensor noise.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.airframe import GRAVITY
from controllers.compiling import hot_kernel, kernel
from controllers.geometry import body_axes


class FixGains(NamedTuple):
    """Gains from the innovations of a fix to the corrections of the estimates.

    Attributes:
        velocity: gain from horizontal velocity to velocity, 1.
        tilt: gain from horizontal velocity to attitude, rad s/m.
        tilt_bias: gain from horizontal velocity to the bias of the rates about horizontal axes, rad/m.
        heading: gain from heading to attitude, 1.
        heading_bias: gain from heading to the bias of the yaw rate, 1/s.
        height: gain from height to height, 1.
        climb: gain from height to climb rate, 1/s.
        lift_bias: gain from height to the bias of the vertical acceleration, 1/s^2.
    """

    velocity: float
    tilt: float
    tilt_bias: float
    heading: float
    heading_bias: float
    height: float
    climb: float
    lift_bias: float


class StateEstimate(NamedTuple):
    """State estimates of N drones.

    Attributes:
        step: interval between two readings of gyroscope and accelerometer, s.
        gravity: gravitational acceleration, m/s^2.
        gains: gains of the corrections by fixes.
        qpos: (N, 7), x and y (not estimated), height (m) and attitude quaternion w x y z, body to world.
        qvel: (N, 6), velocity (m/s, world) and body rates (rad/s, body).
        rate_bias: (3, N), gyroscope bias, rad/s, body.
        lift_bias: (N,), accelerometer bias of the vertical acceleration, m/s^2, world.
    """

    step: float
    gravity: float
    gains: FixGains
    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]
    rate_bias: NDArray[np.float64]
    lift_bias: NDArray[np.float64]


def design_fixes(
    *,
    period: float,
    gyro_noise: float,
    gyro_walk: float,
    accel_noise: float,
    accel_walk: float,
    velocity_noise: float,
    height_noise: float,
    heading_noise: float,
) -> FixGains:
    """Design the gains of the stationary Kalman filters for given sensor noise.

    Args:
        period: interval of fixes, s.
        gyro_noise: noise density of the gyroscope, rad/s/sqrt(Hz).
        gyro_walk: random walk of the gyroscope bias, rad/s^2/sqrt(Hz).
        accel_noise: noise density of the accelerometer, m/s^2/sqrt(Hz).
        accel_walk: random walk of the accelerometer bias, m/s^3/sqrt(Hz); a horizontal bias acts like a tilt error.
        velocity_noise: standard deviation of a fix's velocity, m/s.
        height_noise: standard deviation of a fix's height, m.
        heading_noise: standard deviation of a fix's heading, rad.
    """
    # The errors of velocity, tilt and rate bias obey v' = g tilt, tilt' = -bias.
    level = _stationary_gain(
        [[0, GRAVITY, 0], [0, 0, -1], [0, 0, 0]],
        (accel_noise, math.hypot(gyro_noise, accel_walk / GRAVITY), gyro_walk),
        velocity_noise,
        period,
    )
    turn = _stationary_gain([[0, -1], [0, 0]], (gyro_noise, gyro_walk), heading_noise, period)
    lift = _stationary_gain([[0, 1, 0], [0, 0, -1], [0, 0, 0]], (0.0, accel_noise, accel_walk), height_noise, period)
    return FixGains(*level, *turn, *lift)


def _stationary_gain(system: Any, densities: tuple[float, ...], measured: float, period: float) -> list[float]:
    """Kalman gain of x' = system x + noise with a measurement of the first state once per period.

    Noise densities have a lower bound, so that perfect sensors have gains too.
    """
    from scipy.linalg import expm, solve_discrete_are  # noqa: PLC0415 - only flights with an IMU need it

    size = len(densities)
    driving = np.diag([max(density, 1e-7) ** 2 for density in densities])
    # Van Loan's method: one exponential gives the transition and the noise covariance of a period.
    block = np.block([[-np.array(system, float), driving], [np.zeros((size, size)), np.array(system, float).T]])
    powers = expm(block * period)
    transition = powers[size:, size:].T
    noise_covariance = transition @ powers[:size, size:]
    measurement = np.zeros((1, size))
    measurement[0, 0] = 1
    variance = np.array([[max(measured, 1e-4) ** 2]])
    prior = solve_discrete_are(transition.T, measurement.T, (noise_covariance + noise_covariance.T) / 2, variance)
    gain = prior @ measurement.T / (measurement @ prior @ measurement.T + variance)
    return [float(share) for share in gain[:, 0]]


@hot_kernel
def integrate(
    state: StateEstimate,
    i: int,
    rate_x: float,
    rate_y: float,
    rate_z: float,
    force_x: float,
    force_y: float,
    force_z: float,
) -> None:
    """Integrate one measurement of drone i's gyroscope (rad/s) and accelerometer (specific force, m/s^2), body frame.

    A measurement belongs to the end of its step, so that the sums match MuJoCo's semi-implicit Euler steps.
    """
    qpos, qvel, step = state.qpos, state.qvel, state.step
    wx, wy, wz = rate_x - state.rate_bias[0, i], rate_y - state.rate_bias[1, i], rate_z - state.rate_bias[2, i]
    qvel[i, 3], qvel[i, 4], qvel[i, 5] = wx, wy, wz
    qw, qx, qy, qz = _rotated(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6], step * wx, step * wy, step * wz)
    qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6] = qw, qx, qy, qz
    xx, xy, xz, yx, yy, yz, zx, zy, zz = body_axes(qw, qx, qy, qz)
    qvel[i, 0] += step * (xx * force_x + xy * force_y + xz * force_z)
    qvel[i, 1] += step * (yx * force_x + yy * force_y + yz * force_z)
    climb = qvel[i, 2] + step * (zx * force_x + zy * force_y + zz * force_z - state.gravity - state.lift_bias[i])
    qvel[i, 2] = climb
    qpos[i, 2] += step * climb


@hot_kernel
def _rotated(
    qw: float, qx: float, qy: float, qz: float, turn_x: float, turn_y: float, turn_z: float
) -> tuple[float, float, float, float]:
    """Rotate a quaternion by small angles (rad) about the body axes; the result has unit length to fourth order."""
    x, y, z = turn_x / 2, turn_y / 2, turn_z / 2
    w = 1 - (x * x + y * y + z * z) / 2
    nw = w * qw - x * qx - y * qy - z * qz
    nx = w * qx + x * qw + z * qy - y * qz
    ny = w * qy + y * qw + x * qz - z * qx
    nz = w * qz + z * qw + y * qx - x * qy
    unit = 1.5 - (nw * nw + nx * nx + ny * ny + nz * nz) / 2
    return unit * nw, unit * nx, unit * ny, unit * nz


@kernel
def correct(state: StateEstimate, i: int, vx: float, vy: float, height: float, heading: float) -> None:
    """Correct the estimate of drone i by a fix.

    Args:
        state: the estimates.
        i: number of the drone.
        vx: measured velocity along x, m/s, world.
        vy: measured velocity along y, m/s, world.
        height: measured height, m.
        heading: measured heading, rad, from the world's x axis to the body's, anticlockwise from above.
    """
    gains, qpos, qvel = state.gains, state.qpos, state.qvel
    xx, xy, xz, yx, yy, yz, zx, zy, zz = body_axes(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6])
    error_x, error_y, error_z = vx - qvel[i, 0], vy - qvel[i, 1], height - qpos[i, 2]
    error_heading = heading - math.atan2(yx, xx)
    error_heading -= 2 * math.pi * math.floor(error_heading / (2 * math.pi) + 0.5)

    qvel[i, 0] += gains.velocity * error_x
    qvel[i, 1] += gains.velocity * error_y
    qpos[i, 2] += gains.height * error_z
    qvel[i, 2] += gains.climb * error_z
    state.lift_bias[i] += gains.lift_bias * error_z

    # Rotations about the world's axes: a positive tilt about y accelerates along x, one about x along -y.
    turn = (-gains.tilt * error_y, gains.tilt * error_x, gains.heading * error_heading)
    bias = (-gains.tilt_bias * error_y, gains.tilt_bias * error_x, gains.heading_bias * error_heading)
    qw, qx, qy, qz = _rotated(
        qpos[i, 3],
        qpos[i, 4],
        qpos[i, 5],
        qpos[i, 6],
        xx * turn[0] + yx * turn[1] + zx * turn[2],
        xy * turn[0] + yy * turn[1] + zy * turn[2],
        xz * turn[0] + yz * turn[1] + zz * turn[2],
    )
    qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6] = qw, qx, qy, qz
    state.rate_bias[0, i] += xx * bias[0] + yx * bias[1] + zx * bias[2]
    state.rate_bias[1, i] += xy * bias[0] + yy * bias[1] + zy * bias[2]
    state.rate_bias[2, i] += xz * bias[0] + yz * bias[1] + zz * bias[2]
