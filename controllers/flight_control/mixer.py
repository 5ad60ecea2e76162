"""Mixer: from collective thrust and torques to the thrust of each rotor, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.airframe import ROTORS, Airframe
from controllers.compiling import hot_kernel, kernel


def wrench_matrix(airframe: Airframe) -> NDArray[np.float64]:
    """(4, 4) matrix from the rotors' thrusts to total thrust (N) and torques (N m) about the body's x, y and z axes.

    A rotor at (x, y) that pushes with f along z makes the torques y f about x, -x f about y and its yaw ratio times f
    about z.
    """
    x, y = np.array(airframe.rotor_positions).T
    return np.vstack([np.ones(ROTORS), y, -x, np.array(airframe.yaw_ratio)])


@hot_kernel
def wrench(matrix: NDArray[np.float64], thrust: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """What the rotors do to the body: total thrust (N, along z) and torques (N m) about x, y and z, in the body frame.

    Args:
        matrix: (4, 4), see `wrench_matrix`.
        thrust: (4,), N.
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
    """Share thrust and torques out to the rotors; each ends within 0 and `thrust_max`.

    What cannot be had at once is given up in this order: yaw torque, then collective thrust, and roll and pitch (scaled
    together) only if they alone need more than one rotor's range. Yaw first, because a body that heads elsewhere still
    flies, and one that cannot tilt does not.

    Args:
        mixer: (4, 4), inverse of `wrench_matrix`; its first column is 1/4 throughout.
        thrust_max: N, of one rotor.
        total: N.
        torque_x: N m.
        torque_y: N m.
        torque_z: N m.
        thrust_command: (4,), N, written.
    """
    lowest, highest = thrust_max, 0.0
    for rotor in range(ROTORS):
        tilting = total / ROTORS + (mixer[rotor, 1] * torque_x + mixer[rotor, 2] * torque_y)
        f = tilting + mixer[rotor, 3] * torque_z
        thrust_command[rotor] = f
        # Without yaw it must fit as well: what is given up then never jumps.
        lowest, highest = min(lowest, f, tilting), max(highest, f, tilting)
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
    tilting = min(1.0, thrust_max / max(highest - lowest, 1e-12))
    base = min(max(total / ROTORS, -tilting * lowest), thrust_max - tilting * highest)

    yawing = 1.0
    for rotor in range(ROTORS):
        f = base + tilting * thrust_command[rotor]
        thrust_command[rotor] = f
        turn = mixer[rotor, 3] * torque_z
        room = thrust_max - f if turn > 0.0 else f
        if abs(turn) * yawing > room:
            yawing = room / abs(turn)
    yawing = max(yawing, 0.0)
    for rotor in range(ROTORS):
        f = thrust_command[rotor] + yawing * mixer[rotor, 3] * torque_z
        thrust_command[rotor] = min(max(f, 0.0), thrust_max)
