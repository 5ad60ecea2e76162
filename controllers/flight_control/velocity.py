"""Velocity loop: from a desired horizontal velocity to an acceleration, and what disturbs the body.

All vectors are in the world frame, z up.
"""

from __future__ import annotations

from controllers.compiling import hot_kernel
from controllers.geometry import clip_length


@hot_kernel
def velocity_acceleration(
    desired_vx: float, desired_vy: float, measured_vx: float, measured_vy: float, gain: float, a_max: float
) -> tuple[float, float]:
    """Horizontal acceleration that brings the velocity to the desired one as the point mass does, in m/s^2.

    clip((v_desired - v_measured) gain, a_max), the cut being to the length of the vector.

    Args:
        desired_vx: m/s.
        desired_vy: m/s.
        measured_vx: m/s.
        measured_vy: m/s.
        gain: 1/s, one over the time constant of the response.
        a_max: m/s^2.
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
    """Advance the disturbance observer of one axis by one step; returns the predicted velocity and the disturbance.

    A Luenberger observer of v' = a + d, d' = 0 (Franklin, Powell, Workman: Digital Control of Dynamic Systems, ch. 8).
    It is the integral action of the velocity loop. It does not wind up when rotors or tilt are at their limits, because
    `modelled` is what the rotors really do to the body and not what was asked of them.

    Args:
        predicted: m/s, velocity that the observer expected for now.
        disturbance: m/s^2, acceleration that the model does not explain (wind, lost thrust).
        measured: m/s.
        modelled: m/s^2, acceleration by the rotors' present thrust and gravity.
        velocity_gain: 1/s.
        disturbance_gain: 1/s^2.
        disturbance_max: m/s^2, bound of the estimate's absolute value.
        step: s.
    """
    innovation = measured - predicted
    next_predicted = predicted + step * (modelled + disturbance + velocity_gain * innovation)
    next_disturbance = disturbance + step * disturbance_gain * innovation
    return next_predicted, min(max(next_disturbance, -disturbance_max), disturbance_max)
