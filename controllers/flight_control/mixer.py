"""Mixer: from collective thrust and torques to the thrust of each rotor, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.airframe import ROTORS, Airframe
from controllers.compiling import hot_kernel, kernel


def wrench_matrix(airframe: Airframe) -> NDArray[np.float64]:
    """(4, 4) matrix from rotor thrusts (N) to total thrust (N) and torques about the body's x, y and z axes (N m).

    A rotor at (x, y) with the thrust f along z exerts the torques y f about x, -x f about y and its yaw ratio times f
    about z.
    """
    x, y = np.array(airframe.rotor_positions).T
    return np.vstack([np.ones(ROTORS), y, -x, np.array(airframe.yaw_ratio)])


@hot_kernel
def wrench(matrix: NDArray[np.float64], thrust: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Wrench of the rotors on the body: total thrust (N, along z) and torques about x, y and z (N m), body frame.

    Args:
        matrix: (4, 4), see `wrench_matrix`.
        thrust: (4,), thrust of each rotor, N.
    """
    total, torque_x, torque_y, torque_z = 0.0, 0.0, 0.0, 0.0
    for rotor in range(ROTORS):
        f = thrust[rotor]
        total += f
        torque_x += matrix[1, rotor] * f
        torque_y += matrix[2, rotor] * f
        torque_z += matrix[3, rotor] * f
    return total, torque_x, torque_y, torque_z


@hot_kernel
def mix(
    mixer: NDArray[np.float64],
    thrust_max: float,
    total: float,
    torque_x: float,
    torque_y: float,
    torque_z: float,
    thrust_command: NDArray[np.float64],
) -> None:
    """Allocate thrust and torques to the rotors, each within 0 and `thrust_max`.

    At saturation, yaw torque is reduced first, then collective thrust, and roll and pitch (scaled together) only if
    they alone exceed the range of a rotor. Tilt has priority over yaw, because it controls the velocity.

    Args:
        mixer: (4, 4), inverse of `wrench_matrix`; every entry of its first column is 1/4.
        thrust_max: maximum thrust of one rotor, N.
        total: desired collective thrust, N.
        torque_x: desired torque about x, N m.
        torque_y: desired torque about y, N m.
        torque_z: desired torque about z, N m.
        thrust_command: (4,), commanded thrust of each rotor, N; written.
    """
    lowest, highest = thrust_max, 0.0
    for rotor in range(ROTORS):
        without_yaw = total / ROTORS + (mixer[rotor, 1] * torque_x + mixer[rotor, 2] * torque_y)
        f = without_yaw + mixer[rotor, 3] * torque_z
        thrust_command[rotor] = f
        # The thrust without yaw must be in range too, so that the switch to the saturated mixer is continuous.
        lowest, highest = min(lowest, f, without_yaw), max(highest, f, without_yaw)
    if lowest < 0.0 or highest > thrust_max:
        _mix_saturated(mixer, thrust_max, total, torque_x, torque_y, torque_z, thrust_command)


@kernel
def _mix_saturated(
    mixer: NDArray[np.float64],
    thrust_max: float,
    total: float,
    torque_x: float,
    torque_y: float,
    torque_z: float,
    thrust_command: NDArray[np.float64],
) -> None:
    lowest, highest = np.inf, -np.inf
    for rotor in range(ROTORS):
        f = mixer[rotor, 1] * torque_x + mixer[rotor, 2] * torque_y
        thrust_command[rotor] = f
        lowest, highest = min(lowest, f), max(highest, f)
    tilt_scale = min(1.0, thrust_max / max(highest - lowest, 1e-12))
    base = min(max(total / ROTORS, -tilt_scale * lowest), thrust_max - tilt_scale * highest)

    yaw_scale = 1.0
    for rotor in range(ROTORS):
        f = base + tilt_scale * thrust_command[rotor]
        thrust_command[rotor] = f
        yaw_thrust = mixer[rotor, 3] * torque_z
        headroom = thrust_max - f if yaw_thrust > 0.0 else f
        if abs(yaw_thrust) * yaw_scale > headroom:
            yaw_scale = headroom / abs(yaw_thrust)
    yaw_scale = max(yaw_scale, 0.0)
    for rotor in range(ROTORS):
        f = thrust_command[rotor] + yaw_scale * mixer[rotor, 3] * torque_z
        thrust_command[rotor] = min(max(f, 0.0), thrust_max)
