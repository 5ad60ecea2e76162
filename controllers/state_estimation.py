"""What a drone makes of its sensors: attitude, body rates, velocity and height, from inertial sensors and GPS fixes.

A complementary filter: gyroscope and accelerometer, integrated, are right for seconds, the fixes that correct them for
minutes. The velocity of the fixes also tells the tilt, because a tilt that is estimated wrongly turns gravity into a
growing error of velocity (M.-D. Hua: Attitude estimation for accelerated vehicles using GPS/INS measurements, Control
Engineering Practice 18(7), 2010). The gains are those of the stationary Kalman filter of the errors, linear about level
flight, and so follow from the noises.
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
    """Shares of what a fix finds wrong that go to each estimate.

    Attributes:
        velocity: of the horizontal velocity's error, to the velocity.
        tilt: rad s/m, to the attitude.
        tilt_bias: 1/m, rad/s per m/s, to the bias of the rates about horizontal axes.
        heading: of the heading's error, to the attitude.
        heading_bias: 1/s, to the bias of the yaw rate.
        height: of the height's error, to the height.
        climb: 1/s, to the climb rate.
        lift_bias: 1/s^2, to the bias of the vertical acceleration.
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
    """What N drones believe of themselves.

    Attributes:
        step: s, between two readings of gyroscope and accelerometer.
        gravity: m/s^2.
        gains: of the fixes.
        qpos: (N, 7); of the position the height alone, m, then the attitude's quaternion w x y z, body to world.
        qvel: (N, 6), velocity m/s world, body rates rad/s body.
        rate_bias: (3, N), rad/s, body, what the gyroscope tells too much.
        lift_bias: (N,), m/s^2, what the accelerometer tells too much of vertical acceleration.
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
    """Gains of the stationary Kalman filters that these noises ask for.

    Args:
        period: s, between fixes.
        gyro_noise: rad/s/sqrt(Hz).
        gyro_walk: rad/s^2/sqrt(Hz), random walk of its bias.
        accel_noise: m/s^2/sqrt(Hz).
        accel_walk: m/s^3/sqrt(Hz), random walk of its bias, which along the horizontal looks like a tilt.
        velocity_noise: m/s, deviation of a fix's velocity.
        height_noise: m, deviation of a fix's height.
        heading_noise: rad, deviation of a fix's heading.
        gravity: m/s^2.
    """
    # Errors of velocity, tilt and rate bias: v' = g tilt, tilt' = -bias.
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
    """Kalman gain of x' = system x + noise, whose first state is measured once per period.

    The noises have a floor, so that perfect sensors have gains too.
    """
    from scipy.linalg import expm, solve_discrete_are  # noqa: PLC0415 - only flights with an IMU need it

    size = len(densities)
    driving = np.diag([max(density, 1e-7) ** 2 for density in densities])
    # Van Loan's method: one exponential for the transition and for the noise that gathers in a period.
    block = np.block([[-np.array(system, float), driving], [np.zeros((size, size)), np.array(system, float).T]])
    powers = expm(block * period)
    transition = powers[size:, size:].T
    gathered = transition @ powers[:size, size:]
    reading = np.zeros((1, size))
    reading[0, 0] = 1
    variance = np.array([[max(measured, 1e-4) ** 2]])
    prior = solve_discrete_are(transition.T, reading.T, (gathered + gathered.T) / 2, variance)
    gain = prior @ reading.T / (reading @ prior @ reading.T + variance)
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
    """Take one reading of drone i's gyroscope (rad/s) and accelerometer (specific force, m/s^2), in its body frame.

    A reading tells of the end of its step, so that the sums are those of MuJoCo's semi-implicit Euler steps.
    """
    qpos, qvel, step = state.qpos, state.qvel, state.step
    wx, wy, wz = rate_x - state.rate_bias[0, i], rate_y - state.rate_bias[1, i], rate_z - state.rate_bias[2, i]
    qvel[i, 3], qvel[i, 4], qvel[i, 5] = wx, wy, wz
    qw, qx, qy, qz = _turned(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6], step * wx, step * wy, step * wz)
    qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6] = qw, qx, qy, qz
    xx, xy, xz, yx, yy, yz, zx, zy, zz = body_axes(qw, qx, qy, qz)
    qvel[i, 0] += step * (xx * force_x + xy * force_y + xz * force_z)
    qvel[i, 1] += step * (yx * force_x + yy * force_y + yz * force_z)
    climb = qvel[i, 2] + step * (zx * force_x + zy * force_y + zz * force_z - state.gravity - state.lift_bias[i])
    qvel[i, 2] = climb
    qpos[i, 2] += step * climb


@hot_kernel
def _turned(
    qw: float, qx: float, qy: float, qz: float, turn_x: float, turn_y: float, turn_z: float
) -> tuple[float, float, float, float]:
    """The quaternion after a small turn (rad) about the body's axes, of unit length again to fourth order."""
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
    """Let a fix correct what drone i believes.

    Args:
        state: what is believed.
        i: the drone.
        vx: m/s, world, as the fix has it; so is vy.
        vy: m/s, world.
        height: m.
        heading: rad, from the world's x axis to the body's, seen from above.
    """
    gains, qpos, qvel = state.gains, state.qpos, state.qvel
    xx, xy, xz, yx, yy, yz, zx, zy, zz = body_axes(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6])
    off_x, off_y, off_z = vx - qvel[i, 0], vy - qvel[i, 1], height - qpos[i, 2]
    off_heading = heading - math.atan2(yx, xx)
    off_heading -= 2 * math.pi * math.floor(off_heading / (2 * math.pi) + 0.5)

    qvel[i, 0] += gains.velocity * off_x
    qvel[i, 1] += gains.velocity * off_y
    qpos[i, 2] += gains.height * off_z
    qvel[i, 2] += gains.climb * off_z
    state.lift_bias[i] += gains.lift_bias * off_z

    # Turns about the world's axes, told in the body's: leaning about y speeds up along x, about x slows down along y.
    turn = (-gains.tilt * off_y, gains.tilt * off_x, gains.heading * off_heading)
    bias = (-gains.tilt_bias * off_y, gains.tilt_bias * off_x, gains.heading_bias * off_heading)
    qw, qx, qy, qz = _turned(
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
