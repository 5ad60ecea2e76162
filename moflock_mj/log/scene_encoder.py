"""Static scene for viewers: ground, walls of the arena, labels with units, and a body in each drone's frame."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from moflock_mj.log.schemas import POINT_COLOURS, WORLD_FRAME, frame_name

_GROUND = (0.36, 0.40, 0.36, 1.0)
_WALL = (0.35, 0.65, 0.95, 0.12)
_EDGE = (0.35, 0.65, 0.95, 1.0)
_TEXT = (0.95, 0.95, 0.95, 1.0)
_BODY = (0.25, 0.27, 0.30, 1.0)
_ROTOR = (0.75, 0.80, 0.85, 0.8)
_NOSE = (0.90, 0.11, 0.20, 1.0)

_DOT = (118, 128, 140, 255)  # the blue of the walls
_WALL_POINT = np.dtype([("place", "<f4", (3,)), ("rgba", "u1", (4,))])
_POINTS_PER_WALL = 60


def scene(outline: npt.NDArray[np.float64], altitude: float, drones: int, radius: float) -> Any:
    """The `foxglove.SceneUpdate` of a flight.

    Args:
        outline: (M, 2), corners of the arena's wall in order, m, world.
        altitude: flight altitude, m; the walls are twice as high.
        drones: number of drones.
        radius: radius of one drone, m.
    """
    update = SceneUpdate()
    _ground(_entity(update, "ground"), outline)
    _walls(_entity(update, "arena"), outline, altitude)
    _labels(_entity(update, "labels"), outline, altitude)
    for drone in range(drones):
        name = frame_name(drone, drones)
        body = _entity(update, name, frame=name)
        # With the frame locked, the body follows /tf after this single message.
        body.frame_locked = True
        _airframe(body, radius)
    return update


def arena_points(outline: npt.NDArray[np.float64], altitude: float) -> Any:
    """The arena's edges as points, a `foxglove.PointCloud`, for Rerun, which does not draw scenes.

    Args:
        outline: (M, 2), corners of the arena's wall in order, m, world.
        altitude: flight altitude, m.
    """
    share = np.linspace(0, 1, _POINTS_PER_WALL, endpoint=False)[:, None]
    walls = zip(outline, np.roll(outline, -1, axis=0), strict=True)
    ring = np.concatenate([(1 - share) * a + share * b for a, b in walls])
    points = np.zeros((3, len(ring)), _WALL_POINT)
    points["place"][..., :2] = ring
    points["place"][..., 2] = np.array([[0.0], [altitude], [2.0 * altitude]])
    points["rgba"] = _DOT
    cloud = PointCloud(frame_id=WORLD_FRAME, point_stride=_WALL_POINT.itemsize, data=points.tobytes())
    cloud.timestamp.SetInParent()
    cloud.pose.position.SetInParent()
    cloud.pose.orientation.w = 1.0
    for place, name in enumerate("xyz"):
        cloud.fields.add(name=name, offset=4 * place, type=PackedElementField.FLOAT32)
    for place, name in enumerate(POINT_COLOURS):
        cloud.fields.add(name=name, offset=12 + place, type=PackedElementField.UINT8)
    return cloud


def _entity(update: Any, name: str, frame: str = WORLD_FRAME) -> Any:
    return update.entities.add(id=name, frame_id=frame)


def _ground(entity: Any, outline: npt.NDArray[np.float64]) -> None:
    low, high = outline.min(axis=0), outline.max(axis=0)
    size = 1.2 * (high - low)
    # The upper face is just below zero, to avoid flicker with objects on the ground.
    _place(entity.cubes.add(), (*(low + high) / 2, -0.06), size=(*size, 0.1), colour=_GROUND)


def _walls(entity: Any, outline: npt.NDArray[np.float64], altitude: float) -> None:
    top = 2.0 * altitude
    walls = entity.triangles.add()
    walls.pose.orientation.w = 1.0
    _paint(walls.color, _WALL)
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        for corner in ((*a, 0.0), (*b, 0.0), (*b, top), (*a, 0.0), (*b, top), (*a, top)):
            _point(walls.points.add(), corner)
    for height in (0.0, altitude, top):
        ring = _lines(entity, LinePrimitive.LINE_LOOP, _EDGE)
        for corner in outline:
            _point(ring.points.add(), (*corner, height))


def _labels(entity: Any, outline: npt.NDArray[np.float64], altitude: float) -> None:
    low, high = outline.min(axis=0), outline.max(axis=0)
    across, along = high - low
    middle = (low + high) / 2
    for text, place in (
        (f"x: {across:g} m", (middle[0], low[1], 0.0)),
        (f"y: {along:g} m", (low[0], middle[1], 0.0)),
        (f"altitude {altitude:g} m", (*outline[0], altitude)),
    ):
        label = entity.texts.add(text=text, billboard=True, font_size=14.0, scale_invariant=True)
        _place(label, place, colour=_TEXT)


def _airframe(entity: Any, radius: float) -> None:
    """Add a quadrotor of the given radius: a box, four rotors in an X, and a nose in the direction of heading."""
    rotor, arm = 0.35 * radius, 0.65 * radius
    _place(entity.cubes.add(), (0.0, 0.0, 0.0), size=(0.5 * radius, 0.35 * radius, 0.2 * radius), colour=_BODY)
    _place(entity.cubes.add(), (0.3 * radius, 0.0, 0.0), size=(0.2 * radius,) * 3, colour=_NOSE)
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        disc = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
        centre = (x * arm * np.sqrt(0.5), y * arm * np.sqrt(0.5), 0.12 * radius)
        _place(disc, centre, size=(2 * rotor, 2 * rotor, 0.04 * radius), colour=_ROTOR)


def _lines(entity: Any, kind: int, colour: tuple[float, ...]) -> Any:
    lines = entity.lines.add(type=kind, thickness=2.0, scale_invariant=True)
    lines.pose.orientation.w = 1.0
    _paint(lines.color, colour)
    return lines


def _place(
    primitive: Any, centre: tuple[float, ...], *, colour: tuple[float, ...], size: tuple[float, ...] = ()
) -> None:
    _point(primitive.pose.position, centre)
    primitive.pose.orientation.w = 1.0
    _paint(primitive.color, colour)
    if size:
        _point(primitive.size, size)


def _point(point: Any, place: tuple[float, ...]) -> None:
    point.x, point.y, point.z = place


def _paint(color: Any, rgba: tuple[float, ...]) -> None:
    color.r, color.g, color.b, color.a = rgba
