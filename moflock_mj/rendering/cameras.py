"""Cameras of a flight: oblique overview of the whole arena, top view, and chase camera behind one drone."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from moflock_mj.errors import RenderError
from moflock_mj.visualization.playback import Playback, Track

CAMERAS = ("overview", "chase", "top")
"""Names of the cameras."""

FIELD_OF_VIEW = 45.0
"""Vertical field of view, degrees."""

_MARGIN = (0.94, 0.88)
"""Maximum share of the picture's width and height for the arena; the rest is for captions."""

_FARTHEST = 1.5
"""Maximum distance from the centre of a drone that the overview includes, in half sides of the arena."""

_SPARSE = 300_000
"""Approximate number of coordinates with which the extent of a flight is computed."""

_CHASE_WIDTHS = 15.0
"""Distance of the chase camera behind its drone, in widths of a drone."""

_CHASE_ELEVATION = -20.0
_CHASE_SMOOTHING = 1.5
"""Averaging time of the chase camera's heading, s of the video."""

_AT_REST = 0.5
"""Speed below which a drone's velocity does not define its heading, m/s."""


class View(NamedTuple):
    """A free camera.

    Attributes:
        lookat: point at the centre of the picture, (3,), m, world.
        distance: distance from there to the camera, m.
        azimuth: azimuth of the line of sight, degrees, anticlockwise from x.
        elevation: elevation of the line of sight, degrees, negative when looking down.
    """

    lookat: NDArray[np.float64]
    distance: float
    azimuth: float
    elevation: float

    def axes(self) -> NDArray[np.float64]:
        """Unit vectors right, up and forward as rows, (3, 3), world."""
        azimuth, elevation = np.radians([self.azimuth, self.elevation])
        ahead = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        forward = np.cos(elevation) * ahead + np.array([0.0, 0.0, np.sin(elevation)])
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        return np.stack([right, np.cross(right, forward), forward])

    def place(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Project points, (K, 3), m, world, to the picture.

        Returns:
            Coordinates right and up from the centre, (K, 2), in half heights of the picture; and depth, (K,), m,
            negative behind the camera.
        """
        axes = self.axes()
        seen = (np.asarray(points, float) - self.lookat) @ axes.T
        depth = seen[:, 2] + self.distance
        half_height = np.tan(np.radians(FIELD_OF_VIEW) / 2) * np.maximum(np.abs(depth), 1e-9)
        return seen[:, :2] / half_height[:, None], depth

    def set(self, camera: mujoco.MjvCamera) -> None:
        """Apply this view to one of MuJoCo's free cameras."""
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = self.lookat
        camera.distance, camera.azimuth, camera.elevation = self.distance, self.azimuth, self.elevation


CameraPath = Callable[[float], View]
"""Function that returns the view at a time, s."""


def camera_path(playback: Playback, camera: str, aspect: float, speed: float) -> CameraPath:
    """Camera path for the whole flight.

    Args:
        playback: flights to show.
        camera: one of `CAMERAS`.
        aspect: ratio of the picture's width to its height.
        speed: simulated seconds per second of video, for the smoothing of the chase camera.

    Raises:
        RenderError: the camera is unknown.
    """
    if camera not in CAMERAS:
        raise RenderError(f"camera: {camera!r} is unknown: it must be one of {', '.join(CAMERAS)}")
    if camera == "chase":
        return _chase(playback, speed)
    view = _fitting(playback, aspect, *((90.0, -90.0) if camera == "top" else (76.0, -42.0)))
    return lambda _time: view


def _fitting(playback: Playback, aspect: float, azimuth: float, elevation: float) -> View:
    """Nearest view that shows the whole arena and the drones near it."""
    corners = [(*corner, height) for corner in playback.outline for height in (0.0, 2 * playback.altitude)]
    places = np.concatenate([_sparse(track) for track in playback.tracks])
    reach = _FARTHEST * np.abs(playback.outline).max(axis=0)
    strays = places[(np.abs(places[:, :2]) < reach).all(axis=1)]
    points = np.concatenate([np.array(corners), strays])
    view = View(np.zeros(3), 10.0 * float(np.abs(points).max()), azimuth, elevation)
    # Each iteration centres the view and moves closer; because of perspective it takes several to converge.
    for _ in range(30):
        seen, _ = view.place(points)
        low, high = seen.min(axis=0), seen.max(axis=0)
        half_height = view.distance * np.tan(np.radians(FIELD_OF_VIEW) / 2)
        middle = (low + high) / 2 * half_height @ view.axes()[:2]
        taken = float(np.max((high - low) / 2 / np.multiply(_MARGIN, (aspect, 1.0))))
        view = view._replace(lookat=view.lookat + middle, distance=view.distance * (0.5 + 0.5 * taken))
    return view


def _sparse(track: Track) -> NDArray[np.float64]:
    """Subsampled positions of a flight's drones, (K, 3), m."""
    step = 1 + track.position.size // _SPARSE
    return track.position[::step].reshape(-1, 3).astype(float)


def _chase(playback: Playback, speed: float) -> CameraPath:
    """Camera behind the followed drone of the first flight, in its direction of flight."""
    track, drone = playback.tracks[0], playback.followed
    azimuth = _headings(track, drone, _CHASE_SMOOTHING * max(speed, 1.0))

    def view(time: float) -> View:
        position = track.at(time).position[drone].astype(float)
        heading = float(np.interp(time, track.t, azimuth))
        return View(position, _CHASE_WIDTHS * playback.drone_width, heading, _CHASE_ELEVATION)

    return view


def _headings(track: Track, drone: int, smoothing: float) -> NDArray[np.float64]:
    """Smoothed direction of a drone's flight, (T,), degrees; at rest it is interpolated."""
    east, north = track.velocity[:, drone, 0].astype(float), track.velocity[:, drone, 1].astype(float)
    moving = np.hypot(east, north) > _AT_REST
    if not moving.any():
        return np.zeros(track.t.size)
    samples = np.arange(track.t.size)
    azimuth = np.interp(samples, samples[moving], np.unwrap(np.arctan2(north[moving], east[moving])))
    period = float(np.median(np.diff(track.t))) if track.t.size > 1 else smoothing
    width = max(1, min(round(smoothing / period), track.t.size))
    padded = np.pad(azimuth, (width // 2, width - 1 - width // 2), mode="edge")
    return np.degrees(np.convolve(padded, np.full(width, 1 / width), mode="valid"))
