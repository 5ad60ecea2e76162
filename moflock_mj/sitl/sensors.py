"""Simulated sensors of each drone in the autopilot's frames: NED, and FRD for the body."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moflock_mj.mavlink.frames import Origin
from moflock_mj.scenario.effect_configs import ImuConfig
from moflock_mj.simulation.random_numbers import RandomStreams
from moflock_mj.simulation.realtime_bodies import RealtimeBodies
from moflock_mj.world.constants import GRAVITY

DECLINATION = math.radians(3.41)
INCLINATION = math.radians(63.16)
FIELD_STRENGTH = 0.4824
"""The earth's magnetic field (gauss) at the default `Origin`: World Magnetic Model 2020 in mid-2024, interpolated
between 40 and 50 degrees north, 0 and 10 degrees east, as in PX4's table. It turns by 0.2 degrees per year."""

MAGNETIC_NOISE = 0.002
"""Standard deviation of the magnetometer, gauss: Honeywell HMC5883L datasheet, 2 milligauss."""

_MEAN_TIME = 5e-3
"""Averaging time of an accelerometer, s: Bosch BMI088 datasheet, bandwidth 80 Hz at 800 readings per second.

An autopilot samples the readings at its own rate; ArduPilot's simulated IMUs do so at 1000, 800 and 760 Hz. Noise that
changes between two of its samples is missing from its integrated velocity: with the scenario's velocity disturbance at
1200 Hz and without averaging, the velocity drifts by 0.25 to 0.5 m/s in one second; with averaging, by a tenth of it.
"""

_FIELD_NED = FIELD_STRENGTH * np.array(
    [
        math.cos(INCLINATION) * math.cos(DECLINATION),
        math.cos(INCLINATION) * math.sin(DECLINATION),
        math.sin(INCLINATION),
    ]
)
_TO_FRD = np.array([1.0, -1.0, -1.0])


class Motion(NamedTuple):
    """Readings of the inertial sensors and GPS of N drones.

    Attributes:
        gyro: angular rates, (N, 3), rad/s, body.
        specific_force: mean specific force over 5 ms or since the last reading, (N, 3), m/s^2, body; (0, 0, -g) at
            rest.
        attitude: true attitude, quaternion (w, x, y, z) from the body to NED, (N, 4).
        position: position with the GPS error, (N, 3), m, NED from the origin.
        velocity: velocity with the GPS error, (N, 3), m/s, NED.
    """

    gyro: NDArray[np.float64]
    specific_force: NDArray[np.float64]
    attitude: NDArray[np.float64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]


class Surroundings(NamedTuple):
    """Readings of the magnetometers and barometers of N drones.

    Attributes:
        magnetic_field: magnetic field, (N, 3), gauss, body.
        pressure: pressure, (N,), Pa.
        temperature: temperature, (N,), degrees Celsius.
        pressure_altitude: altitude of the pressure above mean sea level, (N,), m.
    """

    magnetic_field: NDArray[np.float64]
    pressure: NDArray[np.float64]
    temperature: NDArray[np.float64]
    pressure_altitude: NDArray[np.float64]


class SimulatedSensors:
    """Sensors of all drones, with the noise of `ImuConfig`.

    Args:
        bodies: bodies that carry the sensors.
        imu: parameters of the noise.
        period: interval of the inertial sensors' readings, s.
        origin: geographic position of the world frame's origin.
        streams: random numbers; `inertial` and `walk` for gyroscope and accelerometer, `fix` for magnetometer and
            barometer.
    """

    def __init__(
        self, bodies: RealtimeBodies, imu: ImuConfig, period: float, origin: Origin, streams: RandomStreams
    ) -> None:
        self._bodies, self._imu, self._period, self._origin = bodies, imu, period, origin
        self._noise, self._walk, self._fix = streams.inertial, streams.walk, streams.fix
        drones = len(bodies.qpos)
        self._velocity = bodies.qvel[:, :3].copy()
        self._gyro_bias, self._accel_bias = np.zeros((drones, 3)), np.zeros((drones, 3))
        self._force_history = np.tile([0.0, 0.0, -GRAVITY], (max(round(_MEAN_TIME / period), 1), drones, 1))
        """Ring buffer of the specific force, (readings, N, 3), m/s^2, body."""
        self._readings = 0

    def motion(self) -> Motion:
        """Read gyroscopes, accelerometers and GPS; call it once in each period."""
        bodies, imu, root = self._bodies, self._imu, math.sqrt(self._period)
        qpos, qvel = bodies.qpos, bodies.qvel
        force = (qvel[:, :3] - self._velocity) / self._period
        force[:, 2] += GRAVITY
        self._velocity[:] = qvel[:, :3]
        self._force_history[self._readings % len(self._force_history)] = to_body(qpos[:, 3:], force)
        self._readings += 1
        white, walk = self._noise.standard_normal((2, len(qpos), 3)), self._walk.standard_normal((2, len(qpos), 3))
        self._gyro_bias += imu.gyro_walk * root * walk[0]
        self._accel_bias += imu.accel_walk * root * walk[1]
        position, velocity = qpos[:, :3].copy(), qvel[:, :3].copy()
        position[:, :2] += bodies.position_error.T
        velocity[:, :2] += bodies.velocity_error.T
        return Motion(
            gyro=qvel[:, 3:] * _TO_FRD + self._gyro_bias + imu.gyro_noise / root * white[0],
            specific_force=self._force_history.mean(axis=0) + self._accel_bias + imu.accel_noise / root * white[1],
            attitude=attitude_of_body(qpos[:, 3:]),
            position=ned(position),
            velocity=ned(velocity),
        )

    def surroundings(self) -> Surroundings:
        """Read magnetometers and barometers."""
        qpos = self._bodies.qpos
        draws = self._fix.standard_normal((len(qpos), 4))
        altitude = self._origin.altitude + qpos[:, 2] + self._imu.baro_noise * draws[:, 3]
        field = to_body(qpos[:, 3:], np.broadcast_to(ned(_FIELD_NED), (len(qpos), 3)))
        return Surroundings(
            magnetic_field=field + MAGNETIC_NOISE * draws[:, :3],
            pressure=pressure_at(altitude),
            temperature=15.0 - 0.0065 * altitude,
            pressure_altitude=altitude,
        )


def ned(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert (..., 3) vectors from east, north, up to north, east, down, or back."""
    turned: NDArray[np.float64] = vector[..., [1, 0, 2]] * np.array([1.0, 1.0, -1.0])
    return turned


def to_body(quaternion: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotate world vectors to the body frame FRD, (N, 3).

    Args:
        quaternion: quaternions (w, x, y, z) from the body (FLU) to the world, (N, 4).
        vector: vectors, (N, 3), world.
    """
    (w, x, y, z), (a, b, c) = quaternion.T, vector.T
    # v + 2 w (v x q) + 2 (v x q) x q, with q the quaternion's vector: the inverse rotation.
    p, q, r = b * z - c * y, c * x - a * z, a * y - b * x
    return np.stack(
        (
            a + 2 * (w * p + q * z - r * y),
            -(b + 2 * (w * q + r * x - p * z)),
            -(c + 2 * (w * r + p * y - q * x)),
        ),
        axis=1,
    )


def attitude_of_body(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert quaternions from FLU-to-world to FRD-to-NED, (N, 4), with non-negative w."""
    w, x, y, z = quaternion.T
    attitude = math.sqrt(0.5) * np.stack((w + z, x + y, x - y, w - z), axis=1)
    attitude[attitude[:, 0] < 0] *= -1
    return attitude


def pressure_at(altitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pressure, Pa, at altitudes up to 11 km, m: the International Standard Atmosphere (ISO 2533)."""
    pressure: NDArray[np.float64] = 101_325.0 * (1 - 0.0065 / 288.15 * altitude) ** 5.25588
    return pressure
