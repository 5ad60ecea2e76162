"""Attitude loop and rate loop: from a wanted direction of thrust to body rates, and from those to torques.

Body frame: x forward, y left, z up along the thrust. Rates and torques are in the body frame.
"""

from __future__ import annotations

import math

from controllers.compiling import hot_kernel
from controllers.geometry import clip_length


@hot_kernel
def tilt_rates(nx: float, ny: float, nz: float, gain: float, rate_max: float) -> tuple[float, float]:
    """Roll and pitch rates that turn the thrust towards the direction n by the shortest way, in rad/s.

    Reduced attitude control: heading plays no part in it (Brescianini, D'Andrea: Tilt-Prioritized Quadrocopter Attitude
    Control, 2018). The error is 2 sin(angle / 2): the angle itself when it is small, and still growing upside down.

    Args:
        nx: wanted direction of thrust, a vector of any length in the body frame.
        ny: as nx.
        nz: as nx.
        gain: 1/s.
        rate_max: rad/s, bound of the rates' common length.
    """
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    # Exactly upside down every way is the shortest, and none is taken.
    error = gain * math.sqrt(2.0 / max(length * (length + nz), 1e-12))
    return clip_length(-ny * error, nx * error, rate_max)


@hot_kernel
def heading_rate(north_x: float, north_y: float, gain: float) -> float:
    """Yaw rate that turns the body's x axis back to the world's, in rad/s.

    Args:
        north_x: x in the body frame of the world's x axis.
        north_y: y in the body frame of the world's x axis.
        gain: 1/s.
    """
    if north_x >= 0.0:
        return gain * north_y
    # Facing backwards, the sine would fall again: turn at full rate.
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
    """Torque that brings the body rates w to the wanted ones, in N m.

    gain (wanted - w) + w x I w: the second term cancels the gyroscopic coupling in Euler's equation,
    I w' = torque - w x I w.

    Args:
        roll_rate: rad/s, wanted.
        pitch_rate: rad/s, wanted.
        yaw_rate: rad/s, wanted.
        wx: rad/s, present body rate.
        wy: as wx.
        wz: as wx.
        gain_x: N m s/rad.
        gain_y: as gain_x.
        gain_z: as gain_x.
        inertia_x: kg m^2, principal moment.
        inertia_y: as inertia_x.
        inertia_z: as inertia_x.
    """
    return (
        gain_x * (roll_rate - wx) + (inertia_z - inertia_y) * wy * wz,
        gain_y * (pitch_rate - wy) + (inertia_x - inertia_z) * wz * wx,
        gain_z * (yaw_rate - wz) + (inertia_y - inertia_x) * wx * wy,
    )
