"""Off-screen rendering of a playback with MuJoCo, with captions on top."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from moflock_mj.rendering.cameras import camera_path
from moflock_mj.rendering.legend import DARK, DIM, Font, draw_legend
from moflock_mj.rendering.scene import (
    LOOKS,
    SceneDecorator,
    airframes_show,
    geom_capacity,
    grid_cell,
    pose,
    stage_model,
)
from moflock_mj.visualization.playback import TRAIL_SECONDS, Playback

_EVENT_LASTS = 3.0
"""Time for which an event is shown, s of video."""

_TEXT = (238, 242, 247)


class VideoRenderer:
    """Renderer of video frames; MUJOCO_GL must be set before MuJoCo is imported.

    Args:
        playback: flights to show.
        camera: overview, chase or top.
        speed: simulated seconds per second of video.
        size: width and height, pixels.
    """

    def __init__(self, playback: Playback, camera: str, speed: float, size: tuple[int, int]) -> None:
        width, height = size
        self._playback, self._speed = playback, speed
        self._model = stage_model(playback)
        self._model.vis.global_.offwidth, self._model.vis.global_.offheight = size
        self._data = mujoco.MjData(self._model)
        capacity = self._model.ngeom + geom_capacity(playback)
        self._renderer = mujoco.Renderer(self._model, height, width, max_geom=capacity)
        self._options = mujoco.MjvOption()
        self._options.geomgroup[:] = 0
        self._options.geomgroup[0] = 1
        self._decorator = SceneDecorator(playback, self._renderer.scene)
        self._path = camera_path(playback, camera, width / height, speed)
        self._captions = _Captions(playback, camera, size)

    def shoot(self, time: float) -> NDArray[np.uint8]:
        """Render the frame at a time, s: (height, width, 3)."""
        moments = [track.at(time) for track in self._playback.tracks]
        pose(self._data, self._model, moments)
        view, camera = self._path(time), mujoco.MjvCamera()
        view.set(camera)
        self._options.geomgroup[LOOKS] = airframes_show(self._playback, moments, view)
        self._renderer.update_scene(self._data, camera, self._options)
        # With software rendering, these take several times as long as the rest.
        for costly in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._renderer.scene.flags[costly] = 0
        self._decorator.paint(time, moments, view)
        event = self._playback.event_at(time, _EVENT_LASTS * self._speed)
        return self._captions.on(self._renderer.render(), time, self._speed, event)


class _Captions:
    """Captions of a frame: time, flights and their objectives, legend, and the latest event."""

    def __init__(self, playback: Playback, camera: str, size: tuple[int, int]) -> None:
        self._playback, (self._width, self._height) = playback, size
        self._unit = max(min(self._height / 36, self._width / 64), 8.5)  # panels do not overlap
        self._font = ImageFont.load_default(self._unit)
        self._small = ImageFont.load_default(0.8 * self._unit)
        self._legend = draw_legend(playback.legend, self._unit)
        self._note = self._panel([self._notes(camera)], self._small, 0.8 * self._unit, DIM)

    def on(self, picture: NDArray[np.uint8], time: float, speed: float, event: str) -> NDArray[np.uint8]:
        """Draw the captions on a picture."""
        image, unit = Image.fromarray(picture), round(0.6 * self._unit)
        lines = [f"{time:.1f} s" + (f", shown at {speed:.3g}x" if speed != 1 else "")]
        for track in self._playback.tracks:
            f_1, f_2 = (float(np.interp(time, track.t, values)) for values in track.objectives.T)
            ended = f", ended at {track.t[-1]:.1f} s" if time > track.t[-1] + 1e-6 else ""
            lines.append(f"{track.name}: F_1 {f_1:.3f}, F_2 {f_2:.3f}{ended}")
        bottom, note = self._height - unit, self._note
        panels = [(self._panel(lines, self._font, self._unit, _TEXT), unit, unit)]
        panels.append((self._legend, unit, bottom - self._legend.height))
        panels.append((note, self._width - unit - note.width, bottom - note.height))
        if event:
            panel = self._panel([event], self._font, self._unit, _TEXT)
            panels.append((panel, self._width - unit - panel.width, unit))
        for panel, left, top in panels:
            image.paste(panel, (left, top), panel)
        return np.asarray(image)

    def _notes(self, camera: str) -> str:
        playback = self._playback
        across, along = np.ptp(playback.outline, axis=0)
        arena = f"arena {across:g} m x {along:g} m in cells of {grid_cell(playback):g} m, trails of {TRAIL_SECONDS:g} s"
        markers = "distant drones as balls" if camera == "chase" else "markers are not to scale"
        return arena + (f", behind drone {playback.followed}, " if camera == "chase" else ", ") + markers

    def _panel(self, lines: list[str], font: Font, size: float, fill: tuple[int, int, int]) -> Image.Image:
        """Panel with lines of text of a size in pixels on a dark background."""
        pad, step = 0.4 * self._unit, 1.3 * size
        width = max(font.getlength(line) for line in lines) + 2 * pad
        panel = Image.new("RGBA", (round(width), round(step * len(lines) + pad)), DARK)
        draw = ImageDraw.Draw(panel)
        for number, line in enumerate(lines):
            draw.text((pad, 0.5 * pad + step * (number + 0.1)), line, fill=fill, font=font)
        return panel
