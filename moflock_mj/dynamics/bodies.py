"""Types of the rigid-body dynamics: constants, state and statistics of all bodies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.flight_control.cascade import Gains

GROUND = -1
"""Number of the ground, in place of a drone's number."""


class FlightStatistics(NamedTuple):
    """Statistics of each body since the start of the flight.

    Attributes:
        upright: (N,), smallest cosine of the tilt.
        altitude_error: (N,), largest altitude error, m.
        saturated: (N,), number of steps with a rotor command at its limit.
        touch_step: (N,), step of the first contact, -1 before it.
        touch_with: (N,), number of the other drone in the first contact, or GROUND.
        steps: (1,), number of steps.
        energy: (N,), energy consumed by the rotors, J.
        power: (N,), present power of the rotors, W.
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
    """Physical effects on the bodies. Each is Off or a named tuple whose type selects its stages.

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
        gains: gains of the controllers, with the figures of the airframe.
        step: integration step, s.
        reach: distance from a body's centre to the farthest point of its collision shape, m.
        power_factor: electrical power of a rotor per thrust^1.5, W/N^1.5, see `moflock_mj.effects.rotor_power`.
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
        qpos: (N, 7), position (m, world) and quaternion w x y z.
        qvel: (N, 6), velocity (m/s, world) and body rates (rad/s, body).
        qacc: (N, 6), acceleration (m/s^2, world) and angular acceleration (rad/s^2, body) of the latest step.
        qfrc_applied: (N, 6), applied force (N, world) and torque (N m, body).
        qfrc_constraint: (N, 6), contact force (N, world) and torque (N m, body) of the latest step.
        altitude: (N,), height to hold, m.
        stopped: (N, 4), 1 for a stopped rotor, which ignores its command; otherwise 0.
        thrust: (N, 4), present thrust of each rotor, N.
        thrust_command: (N, 4), commanded thrust of each rotor, N.
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
    """Rigid-body dynamics of N bodies in one MuJoCo model, for the compiled loop.

    Attributes:
        model: constants.
        controller: gains, or Off if the caller writes `state.thrust_command`.
        effects: physical effects.
        state: state of the bodies.
        statistics: statistics of the flight.
    """

    model: BodyModel
    controller: NamedTuple
    effects: Effects
    state: BodyState
    statistics: FlightStatistics
