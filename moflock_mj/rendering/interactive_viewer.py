"""Playback of one flight, or two in one arena, in MuJoCo's interactive viewer."""

from __future__ import annotations

import contextlib
import os
import sys
import time
import warnings
from collections.abc import Sequence

import mujoco
import numpy as np

from moflock_mj.errors import RenderError
from moflock_mj.rendering.cameras import View, camera_path
from moflock_mj.rendering.scene import SceneDecorator, pose, stage_model
from moflock_mj.simulation.results import AnyFlight
from moflock_mj.visualization.captions import flight_names
from moflock_mj.visualization.playback import Playback, playback_of

KEYS = "space: pause; right, left: 5 s forward, back; up or +, down or -: faster, slower; home: start"
"""Help text of the viewer's keys."""

_SPACE, _RIGHT, _LEFT, _DOWN, _UP, _HOME = 32, 262, 263, 264, 265, 268
"""Key codes of GLFW, which MuJoCo's viewer uses."""

_FASTER, _SLOWER = (_UP, 61, 334), (_DOWN, 45, 333)
"""Key codes of the arrows, and of plus and minus on the keyboard (where plus shares its key with =) and the keypad."""

_SKIP = 5.0
"""Simulated time of a skip forward or back, s."""

_EVENT_LASTS = 3.0
"""Time for which an event is shown, s."""

_FASTEST, _SLOWEST = 64.0, 1 / 16


class Player:
    """Clock of a playback, which can run, pause and skip; it pauses at the end.

    Args:
        begin: simulated time of the start, s.
        end: simulated time of the end, s.
    """

    def __init__(self, begin: float, end: float) -> None:
        self._begin, self._end = begin, end
        self.time = begin
        self.speed = 1.0
        self.runs = True

    def press(self, key: int) -> None:
        """Perform the action of a key; other keys are ignored."""
        if key == _SPACE:
            self.runs = not self.runs
        elif key in (_RIGHT, _LEFT):
            self._go(self.time + (_SKIP if key == _RIGHT else -_SKIP))
        elif key in (*_FASTER, *_SLOWER):
            self.speed = min(max(self.speed * (2.0 if key in _FASTER else 0.5), _SLOWEST), _FASTEST)
        elif key == _HOME:
            self._go(self._begin)

    def advance(self, seconds: float) -> None:
        """Advance by a real time, s."""
        if self.runs:
            self._go(self.time + seconds * self.speed)
            self.runs = self.time < self._end

    def _go(self, moment: float) -> None:
        self.time = min(max(moment, self._begin), self._end)


def show(flights: Sequence[AnyFlight], *, colour: str = "danger") -> None:
    """Open the viewer and play until its window is closed.

    Args:
        flights: one or two flights with samples, in one arena; each of two has its own colour.
        colour: quantity shown by the drones' colour: speed or danger.

    Raises:
        RenderError: there is no display, or the flights cannot be shown together.
    """
    _check_display()
    import mujoco.viewer  # noqa: PLC0415 - loads the window system

    playback = playback_of(flights, colour=colour, names=flight_names(flights))
    player = Player(playback.begin, playback.end)
    model = stage_model(playback)
    data = mujoco.MjData(model)
    with mujoco.viewer.launch_passive(
        model, data, key_callback=player.press, show_left_ui=False, show_right_ui=False
    ) as window:
        camera_path(playback, "overview", 16 / 9, 1.0)(playback.begin).set(window.cam)
        _play(window, playback, player, model, data)


def _check_display() -> None:
    """Check that a window can be opened, since MuJoCo opens it in its own thread, whose failure is not reported.

    Raises:
        RenderError: no window can be opened.
    """
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise RenderError("viewer: there is no display (DISPLAY is not set); --video and --html need none")
    import glfw  # noqa: PLC0415 - loads the window system

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        works = glfw.init()
    if not works:
        raise RenderError("viewer: the display cannot be opened; --video and --html need none")


def _show_legend(window: mujoco.viewer.Handle, playback: Playback) -> None:
    """Show the legend at the bottom left, if the optional library Pillow is installed."""
    with contextlib.suppress(ImportError):
        from moflock_mj.rendering.legend import draw_legend  # noqa: PLC0415

        panel = np.asarray(draw_legend(playback.legend, 18.0).convert("RGB"))
        window.set_images((mujoco.MjrRect(10, 10, panel.shape[1], panel.shape[0]), panel))


def _play(
    window: mujoco.viewer.Handle, playback: Playback, player: Player, model: mujoco.MjModel, data: mujoco.MjData
) -> None:
    """Show the playback at about 60 Hz until the window is closed."""
    _show_legend(window, playback)
    decorator, before = SceneDecorator(playback, window.user_scn), time.monotonic()
    while window.is_running():
        now = time.monotonic()
        player.advance(now - before)
        before = now
        moments = [track.at(player.time) for track in playback.tracks]
        with window.lock():
            camera = window.cam
            view = View(camera.lookat.copy(), camera.distance, camera.azimuth, camera.elevation)
            pose(data, model, moments)
            window.user_scn.ngeom = 0
            decorator.paint(player.time, moments, view)
        state = "" if player.runs else " (paused)"
        words = f"{player.time:.1f} s, {player.speed:g}x{state}"
        event = playback.event_at(player.time, _EVENT_LASTS * player.speed)
        font, corner = mujoco.mjtFontScale.mjFONTSCALE_150, mujoco.mjtGridPos
        texts = [(font, corner.mjGRID_TOPLEFT, words, KEYS), (font, corner.mjGRID_BOTTOMRIGHT, event, "")]
        window.set_texts(texts if event else texts[:1])
        window.sync()
        time.sleep(1 / 60)
