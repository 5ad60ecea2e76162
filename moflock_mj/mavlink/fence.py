"""Fences: polygons and circles in the world frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from moflock_mj.mavlink.dialect import Message, mavlink
from moflock_mj.mavlink.frames import Origin

Place = tuple[float, float]


class Polygon(NamedTuple):
    """Polygon with corners in m, world, whose inside is allowed or forbidden."""

    corners: tuple[Place, ...]
    allowed: bool


class Circle(NamedTuple):
    """Circle with centre and radius in m, world, whose inside is allowed or forbidden."""

    centre: Place
    radius: float
    allowed: bool


class FenceError(ValueError):
    """Mission items that do not form a fence."""


_POLYGONS = {
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}
_CIRCLES = {
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: True,
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: False,
}


def read_fence(items: Sequence[Message], origin: Origin) -> tuple[Polygon | Circle, ...]:
    """Read shapes from a list of mission items.

    Raises:
        FenceError: a command is unknown, a polygon is incomplete, or a radius is not positive.
    """
    shapes: list[Polygon | Circle] = []
    number = 0
    while number < len(items):
        item = items[number]
        if item.command == mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT:
            number += 1
        elif item.command in _CIRCLES:
            if not (math.isfinite(item.param1) and item.param1 > 0):
                raise FenceError("radius")
            shapes.append(Circle(_place(item, origin), item.param1, _CIRCLES[item.command]))
            number += 1
        elif item.command in _POLYGONS:
            count = int(item.param1) if math.isfinite(item.param1) else 0
            vertices = items[number : number + count]
            if count < 3 or len(vertices) < count or any(vertex.command != item.command for vertex in vertices):
                raise FenceError("polygon")
            shapes.append(Polygon(tuple(_place(vertex, origin) for vertex in vertices), _POLYGONS[item.command]))
            number += count
        else:
            raise FenceError("command")
    return tuple(shapes)


def breaches(shapes: Sequence[Polygon | Circle], x: float, y: float) -> bool:
    """Whether a place, m, world, is forbidden: inside a forbidden shape, or outside an allowed one."""
    for shape in shapes:
        if isinstance(shape, Circle):
            inside = math.hypot(x - shape.centre[0], y - shape.centre[1]) <= shape.radius
        else:
            inside = _contains(shape.corners, x, y)
        if inside != shape.allowed:
            return True
    return False


def _contains(corners: tuple[Place, ...], x: float, y: float) -> bool:
    """Whether a ray from the place crosses the polygon's sides an odd number of times."""
    inside = False
    for (ax, ay), (bx, by) in zip(corners, (*corners[1:], corners[0]), strict=True):
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
            inside = not inside
    return inside


def _place(item: Message, origin: Origin) -> Place:
    latitude, longitude = item.x / 1e7, item.y / 1e7
    if abs(latitude) > 90 or abs(longitude) > 180:
        raise FenceError("place")
    return origin.world(latitude, longitude)
