"""Attitude loop and rate loop: from a desired direction of thrust to body rates, and from those to torques.

Body frame: x forward, y left, z up along the thrust. Rates and torques are in the body frame.
"""

from __future__ import annotations

import math

from controllers.compiling import hot_kernel
from controllers.geometry import clip_length


@hot_kernel
def tilt_rates(nx: float, ny: float, nz: float, gain: float, rate_max: float) -> tuple[float, float]:
    """Roll and pitch rates that rotate the thrust towards the direction n by the shortest way, rad/s.

    Reduced attitude control, independent of heading (Brescianini, D'Andrea: Tilt-Prioritized Quadrocopter Attitude
    Control, 2018). The error is 2 sin(angle / 2): about the angle where it is small, and increasing up to 180 degrees.

    Args:
        nx: x of the desired direction of thrust, body frame; the vector may have any length.
        ny: y of the same vector.
        nz: z of the same vector.
        gain: gain from tilt error to body rate, 1/s.
        rate_max: largest norm of the two rates, rad/s.
    """
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    # Exactly upside down the direction is undefined, and the bound on the denominator makes the rates zero.
    error = gain * math.sqrt(2.0 / max(length * (length + nz), 1e-12))
    return clip_length(-ny * error, nx * error, rate_max)


@hot_kernel
def heading_rate(north_x: float, north_y: float, gain: float) -> float:
    """Yaw rate that rotates the body's x axis towards the world's x axis, rad/s.

    Args:
        north_x: x of the world's x axis, body frame.
        north_y: y of the world's x axis, body frame.
        gain: gain from heading error to body rate, 1/s.
    """
    if north_x >= 0.0:
        return gain * north_y
    # Beyond 90 degrees the sine of the error decreases: use its largest value instead.
    return math.copysign(gain, north_y)


@hot_kernel
def rate_torque(
    roll_rate: float,
    pitch_rate: float,
    yaw_rate: float,
    wx: float,
    wy: float,
    wz: float,
    gain_x: float,
    gain_y: float,
    gain_z: float,
    inertia_x: float,
    inertia_y: float,
    inertia_z: float,
) -> tuple[float, float, float]:
    """Torque that brings the body rates w to the desired ones, N m.

    The torque is gain (desired - w) + w x I w. The second term cancels the gyroscopic coupling in Euler's equation,
    I w' = torque - w x I w.

    Args:
        roll_rate: desired rate about x, rad/s.
        pitch_rate: desired rate about y, rad/s.
        yaw_rate: desired rate about z, rad/s.
        wx: present rate about x, rad/s.
        wy: present rate about y, rad/s.
        wz: present rate about z, rad/s.
        gain_x: gain about x, N m s/rad.
        gain_y: gain about y, N m s/rad.
        gain_z: gain about z, N m s/rad.
        inertia_x: principal moment of inertia about x, kg m^2.
        inertia_y: principal moment of inertia about y, kg m^2.
        inertia_z: principal moment of inertia about z, kg m^2.
    """
    return (
        gain_x * (roll_rate - wx) + (inertia_z - inertia_y) * wy * wz,
        gain_y * (pitch_rate - wy) + (inertia_x - inertia_z) * wz * wx,
        gain_z * (yaw_rate - wz) + (inertia_y - inertia_x) * wx * wy,
    )
