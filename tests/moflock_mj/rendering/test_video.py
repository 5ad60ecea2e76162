"""The video's frames, decoded again; and the viewer's clock."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest

from moflock_mj import Scenario
from moflock_mj.errors import RenderError
from moflock_mj.rendering.interactive_viewer import Player, show
from tests.support.flights import fly_small

av = pytest.importorskip("av", reason="PyAV is not installed: the extra `video`")

from moflock_mj.rendering.video import SMALLEST, render_video  # noqa: E402 - after the extra is known to be there

SCENARIO = Scenario(drones=4, duration=2.0, arena_side=60.0)


def flown(point="A"):
    return fly_small(point, SCENARIO)


def frames_of(path):
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize(
    ("camera", "colour"),
    [
        ("overview", "danger"),
        pytest.param("chase", "speed", marks=pytest.mark.slow),
        pytest.param("top", "speed", marks=pytest.mark.slow),
    ],
)
def test_a_video_shows_the_flight(tmp_path, camera, colour):
    told = []
    out = tmp_path / "v.mp4"
    render_video([flown()], out, camera=camera, colour=colour, fps=5, size=SMALLEST, processes=1, progress=told.append)
    frames = frames_of(out)
    assert len(frames) == 10
    assert frames[0].shape == (270, 480, 3)
    assert told[-1] == 1
    assert all(frame.std() > 5 for frame in frames)
    assert np.abs(frames[-1].astype(int) - frames[0]).max() > 60
    assert [path.name for path in tmp_path.iterdir()] == ["v.mp4"]


@pytest.mark.usefixtures("gl")
def test_every_drone_is_seen_in_the_colour_that_the_legend_gives_it(tmp_path):
    render_video([flown()], tmp_path / "v.mp4", camera="top", fps=1, size=(640, 360), processes=1)
    picture = frames_of(tmp_path / "v.mp4")[0].astype(int)
    arena = picture[40:320, 190:450]
    red, _, blue = arena.transpose(2, 0, 1)
    assert np.sum((blue > 150) & (blue - red > 60)) > 4 * 20  # four blue markers of some pixels each


@pytest.mark.usefixtures("gl")
def test_a_rendering_process_that_fails_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr("moflock_mj.rendering.video.find_gl", lambda: "nothing")
    with pytest.raises(RenderError, match=r"ended with status 1: RuntimeError: .*MUJOCO_GL: nothing"):
        render_video([flown()], tmp_path / "v.mp4", processes=1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.usefixtures("gl")
def test_two_flights_share_a_video(tmp_path):
    render_video([flown("A"), flown("B")], tmp_path / "v.mp4", fps=2, size=SMALLEST, processes=2)
    assert len(frames_of(tmp_path / "v.mp4")) == 4


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"fps": 0}, "fps: 0"),
        ({"speed": -1.0}, "speed: -1"),
        ({"speed": 1e-9}, "speed: 1e-09"),
        ({"size": (641, 360)}, "size: 641x360"),
        ({"size": (320, 180)}, r"size: 320x180 .* at least 480x270"),
        ({"size": (9000, 360)}, r"size: 9000x360 .* at most 8192x8192"),
        ({"camera": "side"}, "camera: 'side'"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_bad_settings_are_refused_and_leave_nothing(tmp_path, settings, words):
    with pytest.raises(RenderError, match=words):
        render_video([flown()], tmp_path / "v.mp4", processes=1, **settings)
    assert list(tmp_path.iterdir()) == []


def test_only_mp4_is_written(tmp_path):
    with pytest.raises(RenderError, match=r"must end in \.mp4"):
        render_video([flown()], tmp_path / "v.avi")


def test_no_codec_is_one_line_and_leaves_nothing(tmp_path, monkeypatch):
    class Container:
        def add_stream(self, name, rate):
            raise ValueError(f"no {name} at {rate}")

        def close(self):
            pass

    monkeypatch.setattr(av, "open", lambda *_, **__: Container())
    with pytest.raises(RenderError, match="has no codec libx264"):
        render_video([flown()], tmp_path / "v.mp4", processes=1)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(RenderError, match="av is not installed"):
        render_video([flown()], tmp_path / "v.mp4", processes=1)
    assert list(tmp_path.iterdir()) == []


def test_no_gl_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "nothing")
    with pytest.raises(RenderError, match="no GL: nothing failed"):
        render_video([flown()], tmp_path / "v.mp4", processes=1)
    assert list(tmp_path.iterdir()) == []
    assert os.environ["MUJOCO_GL"] == "nothing"


def test_the_viewer_needs_a_display(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(RenderError, match="there is no display"):
        show([flown()])


def test_the_viewers_clock_runs_rests_and_leaps():
    player = Player(0.0, 20.0)
    player.advance(1.5)
    assert player.time == 1.5
    player.press(32)
    player.advance(1.0)
    assert player.time == 1.5
    player.press(262)
    assert player.time == 6.5
    player.press(263)
    player.press(263)
    assert player.time == 0.0
    player.press(32)
    player.press(61)
    player.press(45)
    player.press(265)
    player.advance(5.0)
    assert player.time == 10.0
    player.advance(100.0)
    assert (player.time, player.runs) == (20.0, False)
    player.press(268)
    assert player.time == 0.0
