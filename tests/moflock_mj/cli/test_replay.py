"""`moflock replay` as a user meets it."""

from __future__ import annotations

import json
import os
import signal
import stat
import subprocess
import time

import pytest

from moflock_mj import Scenario, fly, load_point
from tests.moflock_mj.cli.test_fly import MOFLOCK, run
from tests.moflock_mj.rendering.test_video import needs_gl

SCENARIO = Scenario(drones=4, duration=12.0, arena_side=100.0)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "flight.mcap"
    fly(load_point("A"), scenario=SCENARIO, dynamics="point_mass", log=path, keep_samples=False)
    return path


def test_a_log_tells_its_figures(log):
    done = run("replay", log)
    assert done.returncode == 0, done.stderr
    assert "phi_cluster" in done.stdout
    told = json.loads(run("replay", log, "--json").stdout)
    assert (told["drones"], told["flown"]) == (4, 12.0)


def test_a_log_is_verified(log):
    done = run("replay", log, "--verify")
    assert done.returncode == 0, done.stderr
    assert "bit-identical" in done.stdout


def test_a_log_is_flown_on_with_another_point(log, tmp_path):
    done = run("replay", log, "--resume", "11", "--point", "B", "--log", "b.mcap", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["complete"]
    assert (tmp_path / "b.mcap").exists()


def test_a_broken_log_is_recovered(log, tmp_path):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(log.read_bytes()[:-2000])
    refused = run("replay", broken)
    assert refused.returncode == 2
    assert "--recover" in refused.stderr
    done = run("replay", broken, "--recover", "--log", tmp_path / "mended.mcap")
    assert done.returncode == 0, done.stderr
    assert run("replay", tmp_path / "mended.mcap").returncode == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("absent.mcap",), "absent.mcap"),
        (("LOG", "LOG", "LOG"), "3 logs"),
        (("LOG", "LOG", "--verify"), "--verify of 2 logs"),
        (("LOG", "--verify", "--recover"), "exclude each other"),
        (("LOG", "--resume", "-1"), "-1"),
        (("LOG", "--size", "big", "--video", "x.mp4"), "size: 'big'"),
        (("LOG", "--picture", "/proc/none/x.png"), "/proc/none"),
        (("LOG", "LOG", "--csv", "x.csv"), "csv: 2 logs"),
        (("LOG", "--camera", "side"), "side"),
        (("absent.mcap", "--recover"), "absent.mcap: no such file"),
        (("LOG", "--video", "x.mp4", "--size", "9000x9000"), "size: 9000x9000"),
        (("LOG", "--layouts", "/dev/null/x"), "not a folder: /dev/null"),
    ],
)
def test_bad_input_is_one_line_and_status_2(log, tmp_path, arguments, words):
    done = run("replay", *(log if word == "LOG" else word for word in arguments), cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments", [("--csv", "PIPE"), ("--recover", "--log", "PIPE"), ("--resume", "1", "--log", "PIPE")]
)
def test_only_files_are_replaced(log, tmp_path, arguments):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    done = run("replay", log, *(pipe if word == "PIPE" else word for word in arguments))
    assert done.returncode == 2
    assert "must be a file" in done.stderr
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert list(tmp_path.iterdir()) == [pipe]


def test_gl_is_needed_for_videos_only(log, tmp_path):
    refused = run("replay", log, "--video", "x.mp4", cwd=tmp_path, MUJOCO_GL="nothing")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "no GL: nothing failed" in refused.stderr
    assert list(tmp_path.iterdir()) == []
    done = run("fly", "--drones", "2", "--duration", "1", "--log", "none", MUJOCO_GL="nothing")
    assert done.returncode == 0, done.stderr


@needs_gl
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_video_that_is_broken_off_leaves_nothing(log, tmp_path, number):
    (tmp_path / "out").mkdir()
    (tmp_path / "scratch").mkdir()
    video = subprocess.Popen(
        [MOFLOCK, "replay", log, "--video", tmp_path / "out" / "x.mp4", "--fps", "240"],
        env={**os.environ, "TMPDIR": str(tmp_path / "scratch")},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # A shell's background job, such as these tests may be, ignores Ctrl-C, and so would its children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509 - it is one call
    )
    deadline = time.monotonic() + 200
    while not list((tmp_path / "scratch").glob("moflock-video-*/1.txt")) and time.monotonic() < deadline:
        time.sleep(0.05)
    video.send_signal(number)
    video.communicate(timeout=60)
    assert video.returncode == 128 + number
    assert list((tmp_path / "out").iterdir()) == list((tmp_path / "scratch").iterdir()) == []
