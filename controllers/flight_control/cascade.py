"""Cascaded flight controller of one drone: from a desired velocity and an altitude to the thrust of each rotor."""

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
"""Number of entries of a drone's observer: predicted velocity (m/s), then disturbance (m/s^2), both in the world frame.

The initial velocity of a drone initialises the first three."""


class Gains(NamedTuple):
    """Gains, limits and vehicle data of the controller, see `controllers.flight_control.gain_design.design_gains`.

    Attributes:
        step: period of the controller, s.
        mass: mass of the vehicle, kg.
        inertia_x: moment of inertia about x, kg m^2.
        inertia_y: moment of inertia about y, kg m^2.
        inertia_z: moment of inertia about z, kg m^2.
        gravity: gravitational acceleration, m/s^2.
        thrust_max: maximum thrust of one rotor, N.
        rotor_blend: fraction of the step to its command that a rotor's thrust covers per period, 1 - exp(-step / lag).
        velocity_gain: gain from velocity to acceleration, the inverse of the response's time constant, 1/s.
        a_max: largest commanded horizontal acceleration, m/s^2.
        tilt_tangent: tangent of the largest commanded tilt.
        tilt_cosine: cosine of the largest commanded tilt.
        climb_rate_max: largest commanded climb or descent rate, m/s.
        vertical_acceleration_max: largest commanded vertical acceleration, m/s^2.
        body_rate_max: largest norm of the commanded roll and pitch rates, rad/s.
        altitude_gain: gain from height to climb rate, 1/s.
        climb_gain: gain from climb rate to acceleration, 1/s.
        tilt_gain: gain from tilt error to body rate, 1/s.
        heading_gain: gain from heading error to body rate, 1/s.
        rate_gain_x: gain from body rate to torque about x, N m s/rad.
        rate_gain_y: gain from body rate to torque about y, N m s/rad.
        rate_gain_z: gain from body rate to torque about z, N m s/rad.
        observer_velocity_gain: gain of the observer from innovation to velocity, 1/s.
        observer_disturbance_gain: gain of the observer from innovation to disturbance, 1/s^2.
        disturbance_max: largest estimated vertical disturbance, m/s^2.
        wind_max: largest estimated disturbance along each horizontal axis, m/s^2.
        wrench_matrix: (4, 4), matrix from rotor thrusts to total thrust and torques.
        mixer: (4, 4), inverse of `wrench_matrix`.
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
    """Wrench of the rotors on the body: total thrust (N, along z) and torques about x, y and z (N m), body frame.

    Args:
        gains: gains of the controller.
        thrust: (4,), present thrust of each rotor, N.
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
    """Run one step of the controller of one drone.

    Args:
        gains: gains of the controller.
        desired_vx: desired velocity along x, m/s, world.
        desired_vy: desired velocity along y, m/s, world.
        altitude: height to hold, m.
        measured_vx: measured velocity along x, m/s, world.
        measured_vy: measured velocity along y, m/s, world.
        qpos: (7,), position (m, world) and quaternion (w x y z, body to world), in MuJoCo's order for a free joint.
        qvel: (6,), velocity (m/s, world) and body rates (rad/s, body frame), in the same order.
        thrust: (4,), present thrust of each rotor, N.
        observer: (6,), see `OBSERVER_SIZE`; advanced by one step.
        thrust_command: (4,), commanded thrust of each rotor, N, from 0 to thrust_max; written.
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
    # Specific force required of the rotors: the desired acceleration less gravity and the estimated disturbance.
    lift = az + gains.gravity - observer[5]
    force_x, force_y = clip_length(ax - observer[3], ay - observer[4], gains.tilt_tangent * lift)
    _observe(gains, measured_vx, measured_vy, qvel[2], xz, yz, zz, thrust, observer)

    roll_rate, pitch_rate = tilt_rates(
        xx * force_x + yx * force_y + zx * lift,
        xy * force_x + yy * force_y + zy * lift,
        xz * force_x + yz * force_y + zz * lift,
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
    """Advance the observer of all three axes; `thrust_x`, `_y`, `_z` is the direction of thrust, world."""
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
