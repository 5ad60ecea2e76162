"""Velocity loop, from a desired horizontal velocity to an acceleration, and disturbance observer.

All vectors are in the world frame, z up.
"""

from __future__ import annotations

from controllers.compiling import hot_kernel
from controllers.geometry import clip_length


@hot_kernel
def velocity_acceleration(
    desired_vx: float, desired_vy: float, measured_vx: float, measured_vy: float, gain: float, a_max: float
) -> tuple[float, float]:
    """Horizontal acceleration towards the desired velocity, with the law of the point mass, m/s^2.

    The acceleration is (v_desired - v_measured) gain, with its norm limited to a_max.

    Args:
        desired_vx: desired velocity along x, m/s.
        desired_vy: desired velocity along y, m/s.
        measured_vx: measured velocity along x, m/s.
        measured_vy: measured velocity along y, m/s.
        gain: inverse of the time constant of the response, 1/s.
        a_max: largest acceleration, m/s^2.
    """
    return clip_length((desired_vx - measured_vx) * gain, (desired_vy - measured_vy) * gain, a_max)


@hot_kernel
def observe_axis(
    predicted: float,
    disturbance: float,
    measured: float,
    modelled: float,
    velocity_gain: float,
    disturbance_gain: float,
    disturbance_max: float,
    step: float,
) -> tuple[float, float]:
    """Advance the disturbance observer of one axis by one step, and return predicted velocity and disturbance.

    A Luenberger observer of v' = a + d, d' = 0 (Franklin, Powell, Workman: Digital Control of Dynamic Systems, ch. 8).
    It is the integral action of the velocity loop. It does not wind up when rotors or tilt are at their limits, because
    `modelled` comes from the present thrust and not from the command.

    Args:
        predicted: velocity predicted for now, m/s.
        disturbance: estimated acceleration that the model does not explain (wind, lost thrust), m/s^2.
        measured: measured velocity, m/s.
        modelled: acceleration by the rotors' present thrust and gravity, m/s^2.
        velocity_gain: gain from innovation to velocity, 1/s.
        disturbance_gain: gain from innovation to disturbance, 1/s^2.
        disturbance_max: largest absolute value of the disturbance, m/s^2.
        step: period of the controller, s.
    """
    innovation = measured - predicted
    next_predicted = predicted + step * (modelled + disturbance + velocity_gain * innovation)
    next_disturbance = disturbance + step * disturbance_gain * innovation
    return next_predicted, min(max(next_disturbance, -disturbance_max), disturbance_max)
