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


class Effects(NamedTuple):
    """What air, wear and failure do to the bodies; each is Off or a named tuple, whose type chooses its stages.

    Attributes:
        disturbance: see `moflock_mj.effects.disturbance`.
        wind: see `moflock_mj.effects.wind`.
        drag: see `moflock_mj.effects.drag`.
        downwash: see `moflock_mj.effects.downwash`.
        ground_effect: see `moflock_mj.effects.ground_effect`.
        battery: see `moflock_mj.effects.battery`.
        imu: see `moflock_mj.sensing.imu`.
        faults: see `moflock_mj.effects.fault_injection`.
    """

    disturbance: NamedTuple
    wind: NamedTuple
    drag: NamedTuple
    downwash: NamedTuple
    ground_effect: NamedTuple
    battery: NamedTuple
    imu: NamedTuple
    faults: NamedTuple


class BodyModel(NamedTuple):
    """Constants of N bodies in one MuJoCo model.

    Attributes:
        gains: of the controllers, with the figures of the airframe.
        step: s.
        reach: m, from a body's centre to the farthest point of its collision shape.
        power_factor: W/N^1.5, see `moflock_mj.effects.rotor_power`.
        mujoco: address of the MuJoCo model.
        mujoco_apart: address of the same model without collision detection.
        data: address of the MuJoCo data.
    """

    gains: Gains
    step: float
    reach: float
    power_factor: float
    mujoco: int
    mujoco_apart: int
    data: int


class BodyState(NamedTuple):
    """State of N bodies; the first five are views of MuJoCo's arrays.

    Attributes:
        qpos: (N, 7), position m world, quaternion w x y z.
        qvel: (N, 6), velocity m/s world, body rates rad/s body.
        qacc: (N, 6), acceleration m/s^2 world, angular rad/s^2 body, of the latest step.
        qfrc_applied: (N, 6), force N world, torque N m body.
        qfrc_constraint: (N, 6), what contacts did in the latest step, same frames.
        altitude: (N,), m, to be held.
        stopped: (N, 4), 1 for a rotor that stands still whatever it is commanded, else 0.
        thrust: (N, 4), N, of the rotors.
        thrust_command: (N, 4), N.
        observer: (N, 6), state of the disturbance observers.
    """

    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]
    qacc: NDArray[np.float64]
    qfrc_applied: NDArray[np.float64]
    qfrc_constraint: NDArray[np.float64]
    altitude: NDArray[np.float64]
    stopped: NDArray[np.uint8]
    thrust: NDArray[np.float64]
    thrust_command: NDArray[np.float64]
    observer: NDArray[np.float64]


class RigidBody(NamedTuple):
    """N bodies in one MuJoCo model, as the compiled loop sees them.

    Attributes:
        model: constants.
        controller: the gains, or Off where others write `state.thrust_command`.
        effects: air, wear and failure.
        state: changes in flight.
        statistics: counts on.
    """

    model: BodyModel
    controller: NamedTuple
    effects: Effects
    state: BodyState
    statistics: FlightStatistics
