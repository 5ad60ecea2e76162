"""Separation of return paths: vehicles that return to their homes in straight lines at one height could collide."""

from __future__ import annotations

import math

Place = tuple[float, float]


def is_clear(way: tuple[Place, Place], others: list[tuple[Place, Place]], clearance: float) -> bool:
    """Whether a straight path keeps the clearance, m, from all others; the path of a hovering vehicle has length 0."""
    return all(distance(way, other) >= clearance for other in others)


def distance(one: tuple[Place, Place], other: tuple[Place, Place]) -> float:
    """Smallest distance between two segments of the plane, m."""
    if _cross(one, other):
        return 0.0
    return min(
        _from_point(one[0], other), _from_point(one[1], other), _from_point(other[0], one), _from_point(other[1], one)
    )


def _from_point(point: Place, segment: tuple[Place, Place]) -> float:
    (px, py), ((ax, ay), (bx, by)) = point, segment
    dx, dy = bx - ax, by - ay
    length_sq = dx * dx + dy * dy
    share = 0.0 if length_sq == 0 else min(max(((px - ax) * dx + (py - ay) * dy) / length_sq, 0.0), 1.0)
    return math.hypot(px - ax - share * dx, py - ay - share * dy)


def _cross(one: tuple[Place, Place], other: tuple[Place, Place]) -> bool:
    """Whether two segments cross in their interiors; the distance between end points covers contact at an end."""

    def side(segment: tuple[Place, Place], point: Place) -> float:
        (ax, ay), (bx, by) = segment
        return (bx - ax) * (point[1] - ay) - (by - ay) * (point[0] - ax)

    return side(one, other[0]) * side(one, other[1]) < 0 and side(other, one[0]) * side(other, one[1]) < 0
