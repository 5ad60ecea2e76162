"""The whole controller of one drone: from a desired velocity and an altitude to the thrust of each rotor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import hot_kernel
from controllers.flight_control.altitude import altitude_acceleration, collective_thrust
from controllers.flight_control.attitude import heading_rate, rate_torque, tilt_rates
from controllers.flight_control.mixer import mix, wrench
from controllers.flight_control.velocity import observe_axis, velocity_acceleration
from controllers.geometry import body_axes, clip_length

OBSERVER_SIZE = 6
"""Entries of a drone's observer: predicted velocity (m/s), then disturbance (m/s^2), both along the world's axes.

A drone that starts in motion starts with its velocity in the first three."""


class Gains(NamedTuple):
    """All numbers of the controller; `controllers.flight_control.gain_design.design_gains` makes them.

    Attributes:
        step: s, period of the controller.
        mass: kg.
        inertia_x: kg m^2; so are inertia_y and inertia_z.
        gravity: m/s^2.
        thrust_max: N, of one rotor.
        rotor_blend: share of the way to its command that a rotor's thrust goes in one step, 1 - exp(-step / lag).
        velocity_gain: 1/s, from velocity to acceleration, one over the time constant of the response.
        a_max: m/s^2, bound of the horizontal acceleration that the velocity loop commands.
        tilt_tangent: bound of the commanded tilt, as its tangent.
        tilt_cosine: the same as its cosine.
        climb_rate_max: m/s.
        vertical_acceleration_max: m/s^2.
        body_rate_max: rad/s, bound of the commanded roll and pitch rates.
        altitude_gain: 1/s, from height to climb rate.
        climb_gain: 1/s, from climb rate to acceleration.
        tilt_gain: 1/s, from tilt error to body rate.
        heading_gain: 1/s, from heading error to body rate.
        rate_gain_x: N m s/rad, from body rate to torque; so are rate_gain_y and rate_gain_z.
        observer_velocity_gain: 1/s.
        observer_disturbance_gain: 1/s^2.
        disturbance_max: m/s^2, bound of the estimated disturbance along each axis.
        wind_max: m/s^2, the same bound along the horizontal axes, which may be larger where wind is expected.
        wrench_matrix: (4, 4), from rotor thrusts to total thrust and torques.
        mixer: (4, 4), its inverse.
    """

    step: float
    mass: float
    inertia_x: float
    inertia_y: float
    inertia_z: float
    gravity: float
    thrust_max: float
    rotor_blend: float
    velocity_gain: float
    a_max: float
    tilt_tangent: float
    tilt_cosine: float
    climb_rate_max: float
    vertical_acceleration_max: float
    body_rate_max: float
    altitude_gain: float
    climb_gain: float
    tilt_gain: float
    heading_gain: float
    rate_gain_x: float
    rate_gain_y: float
    rate_gain_z: float
    observer_velocity_gain: float
    observer_disturbance_gain: float
    disturbance_max: float
    wind_max: float
    wrench_matrix: NDArray[np.float64]
    mixer: NDArray[np.float64]


@hot_kernel
def rotor_wrench(gains: Gains, thrust: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """What the rotors do to the body: total thrust (N, along z) and torques (N m) about x, y and z, in the body frame.

    Args:
        gains: the controller's numbers.
        thrust: (4,), N, present thrust of each rotor.
    """
    return wrench(gains.wrench_matrix, thrust)


@hot_kernel
def track_velocity(
    gains: Gains,
    desired_vx: float,
    desired_vy: float,
    altitude: float,
    measured_vx: float,
    measured_vy: float,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    thrust: NDArray[np.float64],
    observer: NDArray[np.float64],
    thrust_command: NDArray[np.float64],
) -> None:
    """One step of the controller of one drone.

    Args:
        gains: the controller's numbers.
        desired_vx: m/s, world; so is desired_vy.
        desired_vy: m/s, world.
        altitude: m, height to hold.
        measured_vx: m/s, world, horizontal velocity as the drone measures it; so is measured_vy.
        measured_vy: m/s, world.
        qpos: (7,), position (m, world) and quaternion (w x y z, body to world), as MuJoCo has them for a free joint.
        qvel: (6,), velocity (m/s, world) and body rates (rad/s, body frame), as MuJoCo has them.
        thrust: (4,), N, present thrust of each rotor.
        observer: (6,), see `OBSERVER_SIZE`; advanced by one step.
        thrust_command: (4,), N, written, within 0 and thrust_max.
    """
    xx, xy, xz, yx, yy, yz, zx, zy, zz = body_axes(qpos[3], qpos[4], qpos[5], qpos[6])

    ax, ay = velocity_acceleration(desired_vx, desired_vy, measured_vx, measured_vy, gains.velocity_gain, gains.a_max)
    az = altitude_acceleration(
        altitude,
        qpos[2],
        qvel[2],
        gains.altitude_gain,
        gains.climb_gain,
        gains.climb_rate_max,
        gains.vertical_acceleration_max,
    )
    # Specific force wanted of the rotors: what the motion needs, less what gravity and the disturbance do already.
    lift = az + gains.gravity - observer[5]
    push_x, push_y = clip_length(ax - observer[3], ay - observer[4], gains.tilt_tangent * lift)
    _observe(gains, measured_vx, measured_vy, qvel[2], xz, yz, zz, thrust, observer)

    roll_rate, pitch_rate = tilt_rates(
        xx * push_x + yx * push_y + zx * lift,
        xy * push_x + yy * push_y + zy * lift,
        xz * push_x + yz * push_y + zz * lift,
        gains.tilt_gain,
        gains.body_rate_max,
    )
    torque_x, torque_y, torque_z = rate_torque(
        roll_rate,
        pitch_rate,
        heading_rate(xx, xy, gains.heading_gain),
        qvel[3],
        qvel[4],
        qvel[5],
        gains.rate_gain_x,
        gains.rate_gain_y,
        gains.rate_gain_z,
        gains.inertia_x,
        gains.inertia_y,
        gains.inertia_z,
    )
    total = collective_thrust(gains.mass * lift, zz, gains.tilt_cosine)
    mix(gains.mixer, gains.thrust_max, total, torque_x, torque_y, torque_z, thrust_command)


@hot_kernel
def _observe(
    gains: Gains,
    measured_vx: float,
    measured_vy: float,
    climb_rate: float,
    thrust_x: float,
    thrust_y: float,
    thrust_z: float,
    thrust: NDArray[np.float64],
    observer: NDArray[np.float64],
) -> None:
    """Advance the observer of all three axes; `thrust_x`, `_y`, `_z` is the direction of thrust in the world."""
    total = 0.0
    for rotor in range(thrust.shape[0]):
        total += thrust[rotor]
    force = total / gains.mass
    measured = (measured_vx, measured_vy, climb_rate)
    modelled = (force * thrust_x, force * thrust_y, force * thrust_z - gains.gravity)
    bounds = (gains.wind_max, gains.wind_max, gains.disturbance_max)
    for axis in range(3):
        observer[axis], observer[3 + axis] = observe_axis(
            observer[axis],
            observer[3 + axis],
            measured[axis],
            modelled[axis],
            gains.observer_velocity_gain,
            gains.observer_disturbance_gain,
            bounds[axis],
            gains.step,
        )
