"""What each drone's sensors tell its autopilot, in the autopilot's frames: NED, and bodies forward, right, down."""

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
"""Gauss. The earth's field where `Origin` is by default: World Magnetic Model 2020 at the middle of 2024, interpolated
between 40 and 50 degrees north, 0 and 10 degrees east, as PX4 does in its table. It turns by 0.2 degrees a year."""

MAGNETIC_NOISE = 0.002
"""Gauss, deviation: Honeywell HMC5883L datasheet, 2 milligauss."""

_FELT_FOR = 5e-3
"""s, over which an accelerometer takes its mean: Bosch BMI088 datasheet, bandwidth 80 Hz at 800 readings a second.

An autopilot reads at a rate of its own, ArduPilot's simulated IMUs at 1000, 800 and 760 Hz, what we tell at ours. Noise
that changes between two of its readings is lost for the velocity that it sums up: in one second of the scenario's outer
noise, told at 1200 Hz without this mean, that goes astray by 0.25 to 0.5 m/s. With it, by a tenth of that.
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
    """What inertial sensors and GPS tell of N drones.

    Attributes:
        gyro: (N, 3), rad/s, body.
        specific_force: (N, 3), m/s^2, body, the mean over 5 ms or since the reading before; (0, 0, -g) at rest.
        attitude: (N, 4), quaternion w x y z from the body to NED, the truth.
        position: (N, 3), m, NED from the origin, with the error of the GPS.
        velocity: (N, 3), m/s, NED, with the error of the GPS.
    """

    gyro: NDArray[np.float64]
    specific_force: NDArray[np.float64]
    attitude: NDArray[np.float64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]


class Surroundings(NamedTuple):
    """What magnetometer and barometer tell of N drones.

    Attributes:
        magnetic_field: (N, 3), gauss, body.
        pressure: (N,), Pa.
        temperature: (N,), degrees Celsius.
        pressure_altitude: (N,), m above mean sea level, that the pressure stands for.
    """

    magnetic_field: NDArray[np.float64]
    pressure: NDArray[np.float64]
    temperature: NDArray[np.float64]
    pressure_altitude: NDArray[np.float64]


class SimulatedSensors:
    """The sensors of all drones, with the noise of `ImuConfig`.

    Args:
        bodies: whose they are.
        imu: figures of the noise.
        period: s, between two readings of the inertial sensors.
        origin: of the world on the globe.
        streams: `inertial` and `walk` are for gyroscope and accelerometer, `fix` for magnetometer and barometer.
    """

    def __init__(
        self, bodies: RealtimeBodies, imu: ImuConfig, period: float, origin: Origin, streams: RandomStreams
    ) -> None:
        self._bodies, self._imu, self._period, self._origin = bodies, imu, period, origin
        self._noise, self._walk, self._fix = streams.inertial, streams.walk, streams.fix
        drones = len(bodies.qpos)
        self._velocity = bodies.qvel[:, :3].copy()
        self._gyro_bias, self._accel_bias = np.zeros((drones, 3)), np.zeros((drones, 3))
        self._felt = np.tile([0.0, 0.0, -GRAVITY], (max(round(_FELT_FOR / period), 1), drones, 1))
        """(readings, N, 3), m/s^2, body, a ring of the specific force in the latest periods."""
        self._readings = 0

    def motion(self) -> Motion:
        """Read gyroscopes, accelerometers and GPS; to be called once in each period."""
        bodies, imu, root = self._bodies, self._imu, math.sqrt(self._period)
        qpos, qvel = bodies.qpos, bodies.qvel
        force = (qvel[:, :3] - self._velocity) / self._period
        force[:, 2] += GRAVITY
        self._velocity[:] = qvel[:, :3]
        self._felt[self._readings % len(self._felt)] = to_body(qpos[:, 3:], force)
        self._readings += 1
        white, walk = self._noise.standard_normal((2, len(qpos), 3)), self._walk.standard_normal((2, len(qpos), 3))
        self._gyro_bias += imu.gyro_walk * root * walk[0]
        self._accel_bias += imu.accel_walk * root * walk[1]
        position, velocity = qpos[:, :3].copy(), qvel[:, :3].copy()
        position[:, :2] += bodies.position_error.T
        velocity[:, :2] += bodies.velocity_error.T
        return Motion(
            gyro=qvel[:, 3:] * _TO_FRD + self._gyro_bias + imu.gyro_noise / root * white[0],
            specific_force=self._felt.mean(axis=0) + self._accel_bias + imu.accel_noise / root * white[1],
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
    """North, east, down of (..., 3) east, north, up; and the other way round."""
    turned: NDArray[np.float64] = vector[..., [1, 0, 2]] * np.array([1.0, 1.0, -1.0])
    return turned


def to_body(quaternion: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 3) vectors of our world, as seen from bodies: forward, right, down.

    Args:
        quaternion: (N, 4), w x y z, from the body (forward, left, up) to our world.
        vector: (N, 3), our world.
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
    """(N, 4) quaternions from the body FRD to NED, of those from the body FLU to our world; w is not negative."""
    w, x, y, z = quaternion.T
    attitude = math.sqrt(0.5) * np.stack((w + z, x + y, x - y, w - z), axis=1)
    attitude[attitude[:, 0] < 0] *= -1
    return attitude


def pressure_at(altitude: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pa, at m above mean sea level, up to 11 km: the International Standard Atmosphere (ISO 2533)."""
    pressure: NDArray[np.float64] = 101_325.0 * (1 - 0.0065 / 288.15 * altitude) ** 5.25588
    return pressure
