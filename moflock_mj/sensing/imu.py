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
from controllers.state_estimation import Navigation, correct, design_fixes, integrate
from moflock_mj.effects.fault_injection import has_fix
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.world.constants import GRAVITY
from moflock_mj.world.state import World


class Sensors(NamedTuple):
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
        navigation: what the drones believe.
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
    navigation: Navigation
    no_error: NDArray[np.float64]

    def arrays(self) -> dict[str, NDArray[np.float64]]:
        """Every array that changes in flight, by name."""
        navigation = self.navigation
        return {
            "gyro_bias": self.gyro_bias,
            "accel_bias": self.accel_bias,
            "believed_qpos": navigation.qpos,
            "believed_qvel": navigation.qvel,
            "rate_bias": navigation.rate_bias,
            "lift_bias": navigation.lift_bias,
        }


def make_sensors(scenario: Scenario, step: float, beat: float, world: World) -> Sensors | Off:
    """The sensors of a scenario, on drones that know how they start.

    Args:
        scenario: whose `imu` is on or off.
        step: s.
        beat: s, time between two walks of the biases.
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
        gravity=GRAVITY,
    )
    qpos, qvel = np.zeros((drones, 7)), np.zeros((drones, 6))
    qpos[:, 2], qpos[:, 3], qvel[:, :3] = world.position[2], 1, world.velocity.T
    return Sensors(
        gyro_noise=imu.gyro_noise / sqrt(step),
        accel_noise=imu.accel_noise / sqrt(step),
        gyro_walk=imu.gyro_walk * sqrt(beat),
        accel_walk=imu.accel_walk * sqrt(beat),
        baro_noise=imu.baro_noise,
        compass_noise=imu.compass_noise,
        gyro_bias=np.zeros((3, drones)),
        accel_bias=np.zeros((3, drones)),
        navigation=Navigation(step, GRAVITY, gains, qpos, qvel, np.zeros((3, drones)), np.zeros(drones)),
        no_error=np.zeros((2, drones)),
    )


@stage
def believed(
    sensors: NamedTuple, qpos: NDArray[np.float64], qvel: NDArray[np.float64], velocity_error: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """What the controllers go by; chosen by the type of `sensors`.

    Args:
        sensors: Sensors, or Off where drones know the truth but for the GPS error of their velocity.
        qpos: (N, 7), the truth.
        qvel: (N, 6), the truth.
        velocity_error: (2, N), m/s, GPS error.

    Returns:
        qpos and qvel as believed, and the error that is to be added to the horizontal velocity.
    """
    raise NotImplementedError


@stage
def walk_biases(sensors: NamedTuple, draws: NDArray[np.float64]) -> None:
    """Let the biases walk for a beat; chosen by the type of `sensors`. draws: (1, 6, N), N(0, 1)."""


@stage
def feel(
    sensors: NamedTuple,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    qacc: NDArray[np.float64],
    draws: NDArray[np.float32],
    k: int,
) -> None:
    """Read gyroscopes and accelerometers after a step; chosen by the type of `sensors`.

    Args:
        sensors: the beliefs in it move on.
        qpos: (N, 7), the truth.
        qvel: (N, 6), the truth.
        qacc: (N, 6), the first three m/s^2, world: of the step before.
        draws: (steps, 6, N), uniform in [0, 1).
        k: the step.
    """


@stage
def take_bearings(
    sensors: NamedTuple,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    draws: NDArray[np.float64],
    faults: NamedTuple,
) -> None:
    """Correct the beliefs by GPS velocity, barometer and compass; chosen by the type of `sensors`.

    Args:
        sensors: the beliefs in it are corrected.
        qpos: (N, 7), the truth.
        qvel: (N, 6), the truth.
        velocity_error: (2, N), m/s, GPS error.
        draws: (1, 2, N), N(0, 1).
        faults: say who has no GPS velocity.
    """


@implements(believed, Off)
def _truth(
    sensors: Off,  # noqa: ARG001
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    return qpos, qvel, velocity_error


@implements(walk_biases, Off)
def _walk_nothing(sensors: Off, draws: NDArray[np.float64]) -> None:
    pass


@implements(feel, Off)
def _feel_nothing(
    sensors: Off,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    qacc: NDArray[np.float64],
    draws: NDArray[np.float32],
    k: int,
) -> None:
    pass


@implements(take_bearings, Off)
def _take_none(
    sensors: Off,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    draws: NDArray[np.float64],
    faults: NamedTuple,
) -> None:
    pass


@implements(believed, Sensors)
def _estimate(
    sensors: Sensors,
    qpos: NDArray[np.float64],  # noqa: ARG001
    qvel: NDArray[np.float64],  # noqa: ARG001
    velocity_error: NDArray[np.float64],  # noqa: ARG001
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    return sensors.navigation.qpos, sensors.navigation.qvel, sensors.no_error


@implements(walk_biases, Sensors)
def _walk(sensors: Sensors, draws: NDArray[np.float64]) -> None:
    for axis in range(3):
        for i in range(draws.shape[2]):
            sensors.gyro_bias[axis, i] += sensors.gyro_walk * draws[0, axis, i]
            sensors.accel_bias[axis, i] += sensors.accel_walk * draws[0, 3 + axis, i]


@kernel
def read_inertial(
    sensors: Sensors,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    qacc: NDArray[np.float64],
    draws: NDArray[np.float32],
    k: int,
) -> None:
    """As `feel`: body rates, and R^T (acceleration - gravity), with noise and bias.

    The noise is uniform, of the deviation asked for: four times as fast to draw as a normal one, and no different after
    the few steps over which it is summed up before it does anything.
    """
    gyro, accel = sqrt(12.0) * sensors.gyro_noise, sqrt(12.0) * sensors.accel_noise
    gyro_bias, accel_bias = sensors.gyro_bias, sensors.accel_bias
    for i in range(qpos.shape[0]):
        xx, xy, xz, yx, yy, yz, zx, zy, zz = body_axes(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6])
        ax, ay, az = qacc[i, 0], qacc[i, 1], qacc[i, 2] + GRAVITY
        integrate(
            sensors.navigation,
            i,
            qvel[i, 3] + gyro_bias[0, i] + gyro * (draws[k, 0, i] - 0.5),
            qvel[i, 4] + gyro_bias[1, i] + gyro * (draws[k, 1, i] - 0.5),
            qvel[i, 5] + gyro_bias[2, i] + gyro * (draws[k, 2, i] - 0.5),
            xx * ax + yx * ay + zx * az + accel_bias[0, i] + accel * (draws[k, 3, i] - 0.5),
            xy * ax + yy * ay + zy * az + accel_bias[1, i] + accel * (draws[k, 4, i] - 0.5),
            xz * ax + yz * ay + zz * az + accel_bias[2, i] + accel * (draws[k, 5, i] - 0.5),
        )


@implements(feel, Sensors)
def _feel(
    sensors: Sensors,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    qacc: NDArray[np.float64],
    draws: NDArray[np.float32],
    k: int,
) -> None:
    read_inertial(sensors, qpos, qvel, qacc, draws, k)


@implements(take_bearings, Sensors)
def _take_bearings(
    sensors: Sensors,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    velocity_error: NDArray[np.float64],
    draws: NDArray[np.float64],
    faults: NamedTuple,
) -> None:
    believed_velocity = sensors.navigation.qvel
    for i in range(qpos.shape[0]):
        xx, _, _, yx, _, _, _, _, _ = body_axes(qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6])
        fixed = has_fix(faults, i)
        correct(
            sensors.navigation,
            i,
            qvel[i, 0] + velocity_error[0, i] if fixed else believed_velocity[i, 0],
            qvel[i, 1] + velocity_error[1, i] if fixed else believed_velocity[i, 1],
            qpos[i, 2] + sensors.baro_noise * draws[0, 0, i],
            atan2(yx, xx) + sensors.compass_noise * draws[0, 1, i],
        )
