"""Altitude hold: from a desired height to a vertical acceleration, and from that to collective thrust."""

from __future__ import annotations

from controllers.compiling import hot_kernel


@hot_kernel
def altitude_acceleration(
    altitude: float,
    height: float,
    climb_rate: float,
    position_gain: float,
    velocity_gain: float,
    climb_rate_max: float,
    acceleration_max: float,
) -> float:
    """Vertical acceleration that brings the body to `altitude` and holds it there, m/s^2, up.

    Args:
        altitude: desired height, m.
        height: present height, m.
        climb_rate: present vertical velocity, m/s, up.
        position_gain: gain from height to climb rate, 1/s.
        velocity_gain: gain from climb rate to acceleration, 1/s.
        climb_rate_max: largest commanded climb or descent rate, m/s.
        acceleration_max: largest absolute value of the result, m/s^2.
    """
    climb = min(max(position_gain * (altitude - height), -climb_rate_max), climb_rate_max)
    return min(max(velocity_gain * (climb - climb_rate), -acceleration_max), acceleration_max)


@hot_kernel
def collective_thrust(lift: float, upright: float, upright_min: float) -> float:
    """Collective thrust that gives a tilted body the vertical force `lift`, N.

    `lift / upright` holds the height up to the largest commanded tilt. Beyond it, thrust would mostly accelerate the
    body sideways, and falls continuously to zero at 90 degrees.

    Args:
        lift: desired vertical force, N.
        upright: cosine of the tilt.
        upright_min: cosine of the largest commanded tilt.
    """
    if upright <= 0.0:
        return 0.0
    floor = max(upright, upright_min)
    return lift * upright / (floor * floor)
