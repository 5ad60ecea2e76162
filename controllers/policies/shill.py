"""Shill agents (Vasarhelyi et al. 2018): avoidance of walls and obstacles, shared by policies."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from controllers.compiling import hot_kernel, kernel
from controllers.policies.braking import braking_curve
from controllers.policies.interface import Observation


@kernel
def _towards_shill(
    params: NamedTuple, distance: float, normal_x: float, normal_y: float, vx: float, vy: float
) -> tuple[float, float]:
    """Alignment with the shill agent of a wall, m/s, for a drone at `distance` (m) that moves at (vx, vy), m/s."""
    ex, ey = params.v_shill * normal_x - vx, params.v_shill * normal_y - vy  # type: ignore[attr-defined]
    difference_sq = ex * ex + ey * ey
    tolerated = braking_curve(
        distance - params.r0_shill,  # type: ignore[attr-defined]
        params.a_shill,  # type: ignore[attr-defined]
        params.p_shill,  # type: ignore[attr-defined]
    )
    if difference_sq <= tolerated * tolerated:
        return 0.0, 0.0
    difference = sqrt(difference_sq)
    gain = params.c_shill * (difference - tolerated) / difference  # type: ignore[attr-defined]
    return gain * ex, gain * ey


@hot_kernel
def add_walls(
    params: NamedTuple, observation: Observation, i: int, desired_x: float, desired_y: float
) -> tuple[float, float]:
    """Add the terms of all walls to the desired velocity of drone i, m/s.

    Args:
        params: parameters of a policy with the fields r0_shill (m), v_shill (m/s), a_shill (m/s^2), p_shill (1/s) and
            c_shill (1).
        observation: distances and normals of the walls, and the drone's own velocity.
        i: number of the drone.
        desired_x: desired velocity along x without walls, m/s.
        desired_y: desired velocity along y without walls, m/s.
    """
    vx, vy = observation.own_velocity[0, i], observation.own_velocity[1, i]
    for wall in range(observation.wall_distance.shape[0]):
        normal_x, normal_y = observation.wall_normal[wall, 0, i], observation.wall_normal[wall, 1, i]
        shill_x, shill_y = _towards_shill(params, observation.wall_distance[wall, i], normal_x, normal_y, vx, vy)
        desired_x += shill_x
        desired_y += shill_y
    return desired_x, desired_y
