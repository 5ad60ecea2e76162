"""Shill agents: the rule of Vasarhelyi et al. 2018 by which walls and obstacles turn a drone, shared by policies."""

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
    """Velocity towards that of a wall's shill agent, for a drone `distance` metres before it that moves at (vx, vy)."""
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
    params: NamedTuple, observation: Observation, i: int, wanted_x: float, wanted_y: float
) -> tuple[float, float]:
    """The wanted velocity of drone i with the terms of all walls added, m/s.

    Args:
        params: of any policy that has the five fields r0_shill (m), v_shill (m/s), a_shill (m/s^2), p_shill (1/s) and
            c_shill.
        observation: distances and normals of the walls, and the drone's own velocity.
        i: number of the drone.
        wanted_x: m/s.
        wanted_y: m/s.
    """
    vx, vy = observation.own_velocity[0, i], observation.own_velocity[1, i]
    for wall in range(observation.wall_distance.shape[0]):
        normal_x, normal_y = observation.wall_normal[wall, 0, i], observation.wall_normal[wall, 1, i]
        shill_x, shill_y = _towards_shill(params, observation.wall_distance[wall, i], normal_x, normal_y, vx, vy)
        wanted_x += shill_x
        wanted_y += shill_y
    return wanted_x, wanted_y
