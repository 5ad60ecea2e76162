"""Takes pictures of a playback without a screen: MuJoCo renders, and the words are set on top."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from moflock_mj.cameras import camera_path
from moflock_mj.drone_colours import LegendEntry
from moflock_mj.playback import Playback
from moflock_mj.scenery import LOOKS, Painter, grid_cell, pose, room_for, stage_model

_EVENT_LASTS = 3.0
"""Seconds of video for which an event is told."""

_WORDS, _DIM = (238, 242, 247), (170, 182, 196)
_SHADOW = (14, 17, 22)


class Studio:
    """A camera, a stage and a renderer; needs MUJOCO_GL to be set before MuJoCo is imported.

    Args:
        playback: what is shown.
        camera: overview, chase or top.
        speed: simulated over shown time.
        size: width and height, pixels.
    """

    def __init__(self, playback: Playback, camera: str, speed: float, size: tuple[int, int]) -> None:
        width, height = size
        self._playback, self._speed = playback, speed
        self._model = stage_model(playback)
        self._model.vis.global_.offwidth, self._model.vis.global_.offheight = size
        self._data = mujoco.MjData(self._model)
        room = self._model.ngeom + room_for(playback)
        self._renderer = mujoco.Renderer(self._model, height, width, max_geom=room)
        self._options = mujoco.MjvOption()
        self._options.geomgroup[:] = 0
        self._options.geomgroup[0] = self._options.geomgroup[LOOKS] = 1
        self._painter = Painter(playback, self._renderer.scene)
        self._path = camera_path(playback, camera, width / height, speed)
        self._captions = _Captions(playback, camera, size)

    def shoot(self, time: float) -> NDArray[np.uint8]:
        """The picture at a time in s: (height, width, 3)."""
        moments = [track.at(time) for track in self._playback.tracks]
        pose(self._data, self._model, moments)
        view, camera = self._path(time), mujoco.MjvCamera()
        view.set(camera)
        self._renderer.update_scene(self._data, camera, self._options)
        # On a software GL these cost several times the rest.
        for costly in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._renderer.scene.flags[costly] = 0
        self._painter.paint(time, moments, view)
        event = self._playback.event_at(time, _EVENT_LASTS * self._speed)
        return self._captions.on(self._renderer.render(), time, self._speed, event)


class _Captions:
    """The words of a picture: what flies, when, how well, what the colours mean, what just happened."""

    def __init__(self, playback: Playback, camera: str, size: tuple[int, int]) -> None:
        self._playback, (self._width, self._height) = playback, size
        self._unit = unit = max(self._height / 36, 9.0)
        self._font = ImageFont.load_default(unit)
        self._small = ImageFont.load_default(0.8 * unit)
        cell = grid_cell(playback)
        self._note = f"cells of {cell:g} m" + ("" if camera == "chase" else "; markers are not to scale")

    def on(self, picture: NDArray[np.uint8], time: float, speed: float, event: str) -> NDArray[np.uint8]:
        """The picture with its words."""
        image = Image.fromarray(picture)
        draw, unit = ImageDraw.Draw(image), self._unit
        self._say(draw, (unit, 0.7 * unit), f"{time:6.1f} s" + (f"   {speed:.3g}x" if speed != 1 else ""))
        for number, track in enumerate(self._playback.tracks):
            f_1, f_2 = (float(np.interp(time, track.t, values)) for values in track.objectives.T)
            line = f"{track.name}: F_1 {f_1:.3f}, F_2 {f_2:.3f}"
            self._say(draw, (unit, (2.2 + 1.4 * number) * unit), line)
        self._legend(draw, self._playback.legend)
        bottom = self._height - 1.8 * unit
        self._say(draw, (self._width - unit, bottom), self._note, small=True, anchor="ra")
        if event:
            self._say(draw, (self._width / 2, bottom), event, anchor="ma")
        return np.asarray(image)

    def _legend(self, draw: ImageDraw.ImageDraw, legend: Sequence[LegendEntry]) -> None:
        """Entries from the bottom left upwards."""
        unit, top = self._unit, self._height - 1.8 * self._unit
        for entry in reversed(legend):
            right = self._scale(draw, entry, top) if len(entry.bounds) else self._dot(draw, entry, top)
            self._say(draw, (right, top), entry.label, small=True)
            top -= 1.4 * unit

    def _dot(self, draw: ImageDraw.ImageDraw, entry: LegendEntry, top: float) -> float:
        unit = self._unit
        draw.ellipse((unit, top + 0.1 * unit, 1.8 * unit, top + 0.9 * unit), fill=tuple(entry.rgb[0]))
        return 2.3 * unit

    def _scale(self, draw: ImageDraw.ImageDraw, entry: LegendEntry, top: float) -> float:
        """A bar of the scale's colours between its two ends."""
        unit, length = self._unit, 7 * self._unit
        low, high = (f"{bound:g}" for bound in entry.bounds)
        self._say(draw, (unit, top), low, small=True)
        left = 1.4 * unit + draw.textlength(low, font=self._small)
        colours = np.array(entry.rgb, float)
        shares = np.linspace(0, len(colours) - 1, int(length))
        for x, share in enumerate(shares):
            rgb = tuple(int(np.interp(share, range(len(colours)), channel)) for channel in colours.T)
            draw.line((left + x, top + 0.15 * unit, left + x, top + 0.85 * unit), fill=rgb)
        self._say(draw, (left + length + 0.4 * unit, top), high, small=True)
        return left + length + 0.9 * unit + draw.textlength(high, font=self._small)

    def _say(
        self,
        draw: ImageDraw.ImageDraw,
        place: tuple[float, float],
        words: str,
        *,
        small: bool = False,
        anchor: str = "la",
    ) -> None:
        font, fill = (self._small, _DIM) if small else (self._font, _WORDS)
        draw.text(place, words, fill=fill, font=font, anchor=anchor, stroke_width=1, stroke_fill=_SHADOW)
