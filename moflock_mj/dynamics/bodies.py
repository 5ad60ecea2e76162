"""The types of the rigid-body dynamics: constants, state and statistics of all bodies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.flight_control.cascade import Gains

GROUND = -1
"""In place of a drone's number: the ground."""


class FlightStatistics(NamedTuple):
    """What a flight has asked of each body so far.

    Attributes:
        upright: (N,), smallest cosine of the tilt.
        altitude_error: (N,), m, largest.
        saturated: (N,), steps in which a rotor was commanded to its limit.
        touch_step: (N,), step of the first touch, -1 before it.
        touch_with: (N,), the other drone, or GROUND.
        steps: (1,), steps made.
        energy: (N,), J, that the rotors took from the battery.
        power: (N,), W, that they take now.
    """

    upright: NDArray[np.float64]
    altitude_error: NDArray[np.float64]
    saturated: NDArray[np.int64]
    touch_step: NDArray[np.int64]
    touch_with: NDArray[np.int64]
    steps: NDArray[np.int64]
    energy: NDArray[np.float64]
    power: NDArray[np.float64]


class RigidBody(NamedTuple):
    """N bodies in one MuJoCo model, as the compiled loop sees them; arrays of MuJoCo's are views.

    Attributes:
        gains: of the controllers, with the vehicle's figures.
        controller: the gains once more, or Off where others write `thrust_command`.
        step: s.
        altitude: (N,), m, to be held.
        stopped: (N, 4), 1 for a rotor that stands still whatever it is commanded, else 0.
        outer: see `moflock_mj.effects.disturbance`, or Off.
        wind: the air, see `moflock_mj.effects.wind`.
        drag: of the air, see `moflock_mj.effects.drag`, or Off; so are downwash and ground.
        downwash: of the drones on those below them.
        ground: under the rotors.
        battery: of each drone, see `moflock_mj.effects.battery`, or Off.
        power_factor: W/N^1.5, see `moflock_mj.effects.battery`.
        imu: on board, see `moflock_mj.sensing.imu`, or Off.
        faults: see `moflock_mj.effects.fault_injection`, or Off.
        reach: m, from a body's centre to the farthest point of its collision shape.
        model: address of the model.
        model_apart: address of the same model without collision detection.
        data: address of the data.
        qpos: (N, 7), position m world, quaternion w x y z.
        qvel: (N, 6), velocity m/s world, body rates rad/s body.
        qacc: (N, 6), acceleration m/s^2 world, angular rad/s^2 body, of the latest step.
        qfrc_applied: (N, 6), force N world, torque N m body.
        qfrc_constraint: (N, 6), what contacts did in the latest step, same frames.
        thrust: (N, 4), N, of the rotors.
        thrust_command: (N, 4), N.
        observer: (N, 6), state of the disturbance observers.
        statistics: counts on.
    """

    gains: Gains
    controller: NamedTuple
    step: float
    altitude: NDArray[np.float64]
    stopped: NDArray[np.uint8]
    outer: NamedTuple
    wind: NamedTuple
    drag: NamedTuple
    downwash: NamedTuple
    ground: NamedTuple
    battery: NamedTuple
    power_factor: float
    imu: NamedTuple
    faults: NamedTuple
    reach: float
    model: int
    model_apart: int
    data: int
    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]
    qacc: NDArray[np.float64]
    qfrc_applied: NDArray[np.float64]
    qfrc_constraint: NDArray[np.float64]
    thrust: NDArray[np.float64]
    thrust_command: NDArray[np.float64]
    observer: NDArray[np.float64]
    statistics: FlightStatistics
