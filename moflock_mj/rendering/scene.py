"""MuJoCo scene of a flight: the model with all flocks, and the decoration with arena, trails and markers."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from moflock_mj.dynamics.airframe_models import flock_spec
from moflock_mj.rendering.cameras import FIELD_OF_VIEW, View
from moflock_mj.visualization.playback import Moment, Playback, Track

TIMESTEP = 0.005
"""Time step of the model, s; the model is never stepped."""

LOOKS = 2
"""Group of the airframes' visual geoms."""

_MARKER = 1 / 105
"""Radius of a drone's marker, in heights of the picture."""

_TOO_SMALL = 0.5
"""Radius of a marker below which the drone is drawn without one, in widths of a drone."""

_ARROW = 4.2
"""Length of a marker's arrow at v_flock, in radii of the marker."""

_WALL, _EDGE = (0.35, 0.65, 0.95, 0.07), (0.45, 0.72, 1.0, 0.9)
_FAINT = 0.25
_TRAIL_ALPHA = (0.06, 0.85)


def grid_cell(playback: Playback) -> float:
    """Side of the ground's cells, m: 1, 2 or 5 times a power of ten, about a tenth of the arena's side."""
    tenth = float(np.ptp(playback.outline[:, 0])) / 9
    power = 10 ** np.floor(np.log10(tenth))
    return float(power * max(step for step in (1, 2, 5) if step * power <= tenth))


def stage_model(playback: Playback) -> mujoco.MjModel:
    """Model of the ground and all flocks with visual geoms; drone i of all flights together is free joint i."""
    spec = _flock(playback.tracks[0])
    for number, track in enumerate(playback.tracks[1:], start=2):
        guest = _flock(track)
        for element in (guest.geom("ground"), *guest.lights, *guest.materials, *guest.textures):
            guest.delete(element)
        spec.attach(guest, prefix=f"flight_{number}_", frame=spec.worldbody.add_frame())
    _light(spec, grid_cell(playback))
    model = spec.compile()
    # The clipping planes are at half a metre, and beyond the horizon of any camera.
    model.stat.extent = extent = float(np.ptp(playback.outline, axis=0).max())
    model.vis.map.znear, model.vis.map.zfar = 0.4 / extent, 30.0
    model.vis.global_.fovy = FIELD_OF_VIEW
    model.vis.quality.offsamples = model.vis.quality.shadowsize = 0
    return model


def _flock(track: Track) -> Any:
    return flock_spec(track.airframe, track.drones, TIMESTEP, visuals=True)


def _light(spec: Any, cell: float) -> None:
    """Darken ground and sky so that colours are visible, and fit the ground's grid to the arena."""
    cells, sky = spec.texture("cells"), spec.texture("sky")
    cells.rgb1, cells.rgb2, cells.markrgb = (0.29, 0.32, 0.37), (0.32, 0.35, 0.40), (0.50, 0.54, 0.60)
    sky.rgb1, sky.rgb2 = (0.16, 0.22, 0.32), (0.42, 0.50, 0.60)
    spec.material("cells").texrepeat = (0.5 / cell, 0.5 / cell)
    # Light and emission add up to about 1, so that a geom has the colour of the legend.
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = (0.35,) * 3, (0.15,) * 3
    for sun in spec.lights:
        sun.diffuse, sun.specular = (0.35,) * 3, (0.0,) * 3
    spec.visual.rgba.haze = (0.42, 0.50, 0.60, 1.0)


def pose(data: mujoco.MjData, model: mujoco.MjModel, moments: list[Moment]) -> None:
    """Set the poses of all drones."""
    data.qpos.reshape(-1, 7)[:, :3] = np.concatenate([moment.position for moment in moments])
    data.qpos.reshape(-1, 7)[:, 3:] = np.concatenate([moment.quaternion for moment in moments])
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)


def geom_capacity(playback: Playback) -> int:
    """Number of geoms that the decoration of a scene can need."""
    drones = sum(track.drones for track in playback.tracks)
    return 200 + 80 * drones


def airframes_show(playback: Playback, moments: list[Moment], view: View) -> bool:
    """Whether any drone is visible; otherwise markers hide all drones, and they need not be drawn."""
    near = []
    for moment in moments:
        radii, depth = _marker_radii(moment, view)
        near.append(np.any((depth > 0) & (radii < _TOO_SMALL * playback.drone_width)))
    return bool(np.any(near))


def _marker_radii(moment: Moment, view: View) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Radii of markers of equal apparent size, (N,), m, and depth of the drones, (N,), m."""
    _, depth = view.place(moment.position)
    return 2 * _MARKER * np.tan(np.radians(FIELD_OF_VIEW) / 2) * np.maximum(depth, 0.0), depth


class SceneDecorator:
    """Decorator that adds arena, trails and markers to a scene, after the model's own geoms.

    Args:
        playback: flights to show.
        scene: scene of MuJoCo.
    """

    def __init__(self, playback: Playback, scene: mujoco.MjvScene) -> None:
        self.playback = playback
        self.scene = scene

    def paint(self, time: float, moments: list[Moment], view: View) -> None:
        """Add the decoration for one time.

        Args:
            time: time, s.
            moments: state of each flight at that time.
            view: view, which determines the size of markers.
        """
        self._arena()
        for track, moment in zip(self.playback.tracks, moments, strict=True):
            self._trails(track, time)
            self._markers(moment, view)

    def _arena(self) -> None:
        outline, top = self.playback.outline, 2 * self.playback.altitude
        for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            along = (b - a) / np.linalg.norm(b - a)
            turn = np.array([[along[0], -along[1], 0.0], [along[1], along[0], 0.0], [0.0, 0.0, 1.0]])
            size = (float(np.linalg.norm(b - a)) / 2, 0.01, top / 2)
            self._solid(mujoco.mjtGeom.mjGEOM_BOX, size, (*(a + b) / 2, top / 2), turn, _WALL)
            for height, alpha in ((0.05, 1.0), (top, _FAINT)):
                self._line((*a, height), (*b, height), 2.0, (*_EDGE[:3], alpha))
            self._line((*a, 0.0), (*a, top), 1.5, (*_EDGE[:3], 2 * _FAINT))

    def _trails(self, track: Track, time: float) -> None:
        corners, rgb = track.trail(time)
        alphas = np.linspace(*_TRAIL_ALPHA, len(rgb))
        for k, alpha in enumerate(alphas):
            for drone in range(track.drones):
                self._line(corners[k, drone], corners[k + 1, drone], 1.6, (*rgb[k, drone] / 255, alpha))

    def _markers(self, moment: Moment, view: View) -> None:
        """Add a ball and an arrow for a drone that is too small to see, else a coloured disc around it."""
        width = self.playback.drone_width
        radii, depth = _marker_radii(moment, view)
        for drone in np.flatnonzero(depth > 0):
            position, rgb, radius = moment.position[drone], moment.rgb[drone] / 255, float(radii[drone])
            if radius < _TOO_SMALL * width:
                turn = np.empty(9)
                mujoco.mju_quat2Mat(turn, moment.quaternion[drone].astype(float))
                disc = (0.62 * width, 0.62 * width, 0.02 * width)
                self._solid(mujoco.mjtGeom.mjGEOM_CYLINDER, disc, position, turn, (*rgb, 0.4))
            else:
                self._solid(mujoco.mjtGeom.mjGEOM_SPHERE, (0.85 * radius,) * 3, position, np.eye(3), (*rgb, 1.0))
                self._arrow(position, moment.velocity[drone], radius, (*rgb, 1.0))

    def _arrow(self, position: ArrayLike, velocity: NDArray[np.float32], radius: float, rgba: ArrayLike) -> None:
        tip = np.asarray(position) + velocity * (_ARROW * radius / self.playback.v_flock)
        geom = self._next(rgba)
        if geom is not None and np.linalg.norm(velocity) > 0.02 * self.playback.v_flock:
            mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, 0.55 * radius, np.asarray(position, float), tip)
            self.scene.ngeom += 1

    def _line(self, start: ArrayLike, end: ArrayLike, width: float, rgba: ArrayLike) -> None:
        """Add a line with a width in pixels."""
        geom = self._next(rgba)
        if geom is not None:
            ends = np.asarray(start, float), np.asarray(end, float)
            mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_LINE, width, *ends)
            self.scene.ngeom += 1

    def _solid(self, kind: int, size: ArrayLike, place: ArrayLike, turn: ArrayLike, rgba: ArrayLike) -> None:
        geom = self._next(rgba)
        if geom is not None:
            geom.type = kind
            geom.size[:], geom.pos[:], geom.mat[:] = size, place, np.reshape(turn, (3, 3))
            self.scene.ngeom += 1

    def _next(self, rgba: ArrayLike) -> Any:
        """Next free geom of the scene, with emission in a colour; None if the scene is full."""
        if self.scene.ngeom >= self.scene.maxgeom:
            return None
        geom = self.scene.geoms[self.scene.ngeom]
        nowhere = np.zeros(3)
        mujoco.mjv_initGeom(
            geom, mujoco.mjtGeom.mjGEOM_SPHERE, nowhere, nowhere, np.eye(3).ravel(), np.asarray(rgba, np.float32)
        )
        geom.emission, geom.specular = 0.3, 0.0
        return geom
