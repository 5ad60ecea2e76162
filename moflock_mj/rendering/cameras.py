"""Where a flight is looked at from: the whole arena aslant, from above, or behind one drone."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from moflock_mj.errors import RenderError
from moflock_mj.visualization.playback import Playback, Track

CAMERAS = ("overview", "chase", "top")
"""The cameras that there are."""

FIELD_OF_VIEW = 45.0
"""Vertical, degrees."""

_MARGIN = (0.94, 0.88)
"""Share of the picture's width and height that the arena may take; the rest is for words."""

_FARTHEST = 1.5
"""How far from the centre a drone is still kept in an arena's picture, in half sides of the arena."""

_SPARSE = 300_000
"""About how many coordinates are enough to see how far a flock goes."""

_CHASE_WIDTHS = 15.0
"""How far behind its drone the chase camera is, in widths of a drone."""

_CHASE_ELEVATION = -20.0
_CHASE_SMOOTHING = 1.5
"""Time over which the chase camera's turns are averaged, s of the video."""

_AT_REST = 0.5
"""Below this speed, m/s, a drone's velocity does not tell its heading."""


class View(NamedTuple):
    """A free camera.

    Attributes:
        lookat: (3,), m, world, the middle of the picture.
        distance: m, from there to the eye.
        azimuth: degrees, of the line of sight, anticlockwise from x.
        elevation: degrees, of the line of sight over the horizon, negative when looking down.
    """

    lookat: NDArray[np.float64]
    distance: float
    azimuth: float
    elevation: float

    def axes(self) -> NDArray[np.float64]:
        """Right, up and forward as rows, unit vectors in the world frame."""
        azimuth, elevation = np.radians([self.azimuth, self.elevation])
        ahead = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        forward = np.cos(elevation) * ahead + np.array([0.0, 0.0, np.sin(elevation)])
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        return np.stack([right, np.cross(right, forward), forward])

    def place(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Where points (K, 3), m, world, appear.

        Returns:
            (K, 2), right and up of the middle, in half heights of the picture; and (K,), their depth, m, negative
            behind the eye.
        """
        axes = self.axes()
        seen = (np.asarray(points, float) - self.lookat) @ axes.T
        depth = seen[:, 2] + self.distance
        half_height = np.tan(np.radians(FIELD_OF_VIEW) / 2) * np.maximum(np.abs(depth), 1e-9)
        return seen[:, :2] / half_height[:, None], depth

    def set(self, camera: mujoco.MjvCamera) -> None:
        """Move one of MuJoCo's free cameras here."""
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = self.lookat
        camera.distance, camera.azimuth, camera.elevation = self.distance, self.azimuth, self.elevation


CameraPath = Callable[[float], View]
"""Where the camera is at a time in s."""


def camera_path(playback: Playback, camera: str, aspect: float, speed: float) -> CameraPath:
    """A camera for the whole flight.

    Args:
        playback: what it looks at.
        camera: one of `CAMERAS`.
        aspect: width over height of the picture.
        speed: flight's seconds per second of video, by which a chasing camera smooths its turns.

    Raises:
        RenderError: the camera is unknown.
    """
    if camera not in CAMERAS:
        raise RenderError(f"camera: {camera!r} is unknown; there are {', '.join(CAMERAS)}")
    if camera == "chase":
        return _chase(playback, speed)
    view = _fitting(playback, aspect, *((90.0, -90.0) if camera == "top" else (76.0, -42.0)))
    return lambda _time: view


def _fitting(playback: Playback, aspect: float, azimuth: float, elevation: float) -> View:
    """The nearest view that shows the whole arena, and the drones that stay near it."""
    corners = [(*corner, height) for corner in playback.outline for height in (0.0, 2 * playback.altitude)]
    places = np.concatenate([_sparse(track) for track in playback.tracks])
    reach = _FARTHEST * np.abs(playback.outline).max(axis=0)
    strays = places[(np.abs(places[:, :2]) < reach).all(axis=1)]
    points = np.concatenate([np.array(corners), strays])
    view = View(np.zeros(3), 10.0 * float(np.abs(points).max()), azimuth, elevation)
    # Each turn centres what is seen and comes as near as it may; perspective lets it converge, not succeed at once.
    for _ in range(30):
        seen, _ = view.place(points)
        low, high = seen.min(axis=0), seen.max(axis=0)
        half_height = view.distance * np.tan(np.radians(FIELD_OF_VIEW) / 2)
        middle = (low + high) / 2 * half_height @ view.axes()[:2]
        taken = float(np.max((high - low) / 2 / np.multiply(_MARGIN, (aspect, 1.0))))
        view = view._replace(lookat=view.lookat + middle, distance=view.distance * (0.5 + 0.5 * taken))
    return view


def _sparse(track: Track) -> NDArray[np.float64]:
    """Places of a flight's drones, (K, 3), m: enough of them to see how far they go."""
    step = 1 + track.position.size // _SPARSE
    return track.position[::step].reshape(-1, 3).astype(float)


def _chase(playback: Playback, speed: float) -> CameraPath:
    """Behind the followed drone of the first flight, looking where it flies to."""
    track, drone = playback.tracks[0], playback.followed
    azimuth = _headings(track, drone, _CHASE_SMOOTHING * max(speed, 1.0))

    def view(time: float) -> View:
        position = track.at(time).position[drone].astype(float)
        heading = float(np.interp(time, track.t, azimuth))
        return View(position, _CHASE_WIDTHS * playback.drone_width, heading, _CHASE_ELEVATION)

    return view


def _headings(track: Track, drone: int, smoothing: float) -> NDArray[np.float64]:
    """The smoothed direction of a drone's flight, (T,), degrees; where it rests, the direction before."""
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
