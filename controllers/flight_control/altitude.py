"""Altitude hold: from a height to a vertical acceleration, and from that to the rotors' collective thrust."""

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
    """Vertical acceleration that brings the body to `altitude` and holds it there, in m/s^2, up.

    Args:
        altitude: m, wanted height.
        height: m.
        climb_rate: m/s, vertical velocity, up.
        position_gain: 1/s.
        velocity_gain: 1/s.
        climb_rate_max: m/s, bound of the climb and descent that is asked for.
        acceleration_max: m/s^2, bound of the result's absolute value.
    """
    climb = min(max(position_gain * (altitude - height), -climb_rate_max), climb_rate_max)
    return min(max(velocity_gain * (climb - climb_rate), -acceleration_max), acceleration_max)


@hot_kernel
def collective_thrust(lift: float, upright: float, upright_min: float) -> float:
    """Sum of the rotors' thrusts that lifts a tilted body, in N.

    `lift / upright` holds the height at any tilt that the velocity loop asks for. Beyond that tilt it would push the
    body sideways more than lift it, and is blended out: continuously, to zero on the side.

    Args:
        lift: N, wanted vertical force.
        upright: cosine of the tilt.
        upright_min: cosine of the largest tilt that the velocity loop asks for.
    """
    if upright <= 0.0:
        return 0.0
    floor = max(upright, upright_min)
    return lift * upright / (floor * floor)
