"""`moflock replay` as a user meets it."""

from __future__ import annotations

import json
import os
import signal
import stat

import pytest

from tests.support.cli import environment_of, refused, run, run_program, start_program
from tests.support.waiting import wait_until


def test_the_figures_of_a_log_are_shown(small_log):
    done = run("replay", small_log)
    assert done.returncode == 0, done.stderr
    assert "phi_cluster" in done.stdout
    shown = json.loads(run("replay", small_log, "--json").stdout)
    assert (shown["drones"], shown["flown"]) == (4, 12.0)


def test_a_log_is_verified(small_log):
    done = run("replay", small_log, "--verify")
    assert done.returncode == 0, done.stderr
    assert "bit-identical" in done.stdout


def test_a_log_is_flown_on_with_another_point(small_log, tmp_path):
    done = run("replay", small_log, "--resume", "11", "--point", "B", "--log", "b.mcap", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["complete"]
    assert (tmp_path / "b.mcap").exists()


def test_a_broken_log_is_recovered(small_log, tmp_path):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(small_log.read_bytes()[:-2000])
    assert "--recover" in refused("replay", broken)
    done = run("replay", broken, "--recover", "--log", tmp_path / "whole.mcap")
    assert done.returncode == 0, done.stderr
    assert run("replay", tmp_path / "whole.mcap").returncode == 0


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
def test_bad_input_is_one_line_and_status_2(small_log, tmp_path, arguments, words):
    arguments = [small_log if word == "LOG" else word for word in arguments]
    assert words in refused("replay", *arguments, cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments", [("--csv", "PIPE"), ("--recover", "--log", "PIPE"), ("--resume", "1", "--log", "PIPE")]
)
def test_only_files_are_replaced(small_log, tmp_path, arguments):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    arguments = [pipe if word == "PIPE" else word for word in arguments]
    assert "must be a file" in refused("replay", small_log, *arguments)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert list(tmp_path.iterdir()) == [pipe]


@pytest.mark.slow
def test_gl_is_needed_for_videos_only(small_log, tmp_path):
    line = refused("replay", small_log, "--video", "x.mp4", cwd=tmp_path, MUJOCO_GL="nothing")
    assert "no GL: nothing failed" in line
    assert list(tmp_path.iterdir()) == []
    done = run_program("fly", "--drones", "2", "--duration", "1", "--log", "none", MUJOCO_GL="nothing")
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_video_that_is_broken_off_leaves_nothing(small_log, tmp_path, number):
    (tmp_path / "out").mkdir()
    (tmp_path / "scratch").mkdir()
    video = start_program(
        *("replay", small_log, "--video", tmp_path / "out" / "x.mp4", "--fps", "240"),
        env=environment_of({"TMPDIR": tmp_path / "scratch"}),
        # A shell's background job, such as these tests may be, ignores Ctrl-C, and so would its children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    wait_until(lambda: list((tmp_path / "scratch").glob("moflock-video-*/1.txt")), seconds=200)
    video.send_signal(number)
    video.communicate(timeout=60)
    assert video.returncode == 128 + number
    assert list((tmp_path / "out").iterdir()) == list((tmp_path / "scratch").iterdir()) == []
