"""`moflock fleet --physics-for`: programs that it starts, ones that come by themselves, and bad wishes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.cli import refused, run, start_program
from tests.support.waiting import wait_until

STAND_IN = Path(__file__).parents[2] / "support" / "autopilot_stand_in.py"
CALM = "sigma_inner = 0.0\nsigma_outer = 0.0\n"


def alive(words):
    """Whether a process has these in its command line, where words are parted by zeros."""
    commands = (path.read_bytes() for path in Path("/proc").glob("[0-9]*/cmdline") if os.access(path, os.R_OK))
    return any(words.encode() in command for command in commands)


@pytest.mark.slow
def test_it_flies_programs_and_ends_them_with_ctrl_c(tmp_path):
    (tmp_path / "calm.toml").write_text(CALM)
    command = f"{sys.executable} {STAND_IN} ardupilot {{port}} {{sysid}} --of {tmp_path}"
    moflock = start_program(
        "fleet",
        "--physics-for", "ardupilot", "--vehicles", 2, "--physics-port", 0, "--scenario", "calm.toml", "--json",
        "--speed", 100, "--autopilot-command", command, cwd=tmp_path,
    )  # fmt: skip
    start = json.loads(moflock.stdout.readline())
    assert start["physics_for"] == "ardupilot"
    assert len(set(start["ports"])) == 2
    assert "2 ardupilot autopilots connected" in moflock.stderr.readline()
    assert alive(f"--of\0{tmp_path}")
    outputs = [tmp_path / start["folder"] / str(number) / "output.txt" for number in range(2)]
    wait_until(lambda: all(output.read_text().endswith("flying\n") for output in outputs))
    moflock.send_signal(signal.SIGINT)
    out, err = moflock.communicate(timeout=60)
    end = json.loads(out)
    assert (moflock.returncode, err) == (0, "")
    assert end["present"] == 2
    assert end["time"] > 0
    assert end["received"] >= 2 * round(end["time"] * 1200)
    assert not alive(f"--of\0{tmp_path}")
    for output, port in zip(outputs, start["ports"], strict=True):
        assert output.read_text() == f"stand-in of ardupilot at {port}\nflying\n"


@pytest.mark.slow
def test_it_waits_for_programs_that_the_user_starts(tmp_path):
    wish = ("--physics-for", "px4", "--physics-port", 0, "--duration", 1, "--json", "--speed", 100)
    moflock = start_program("fleet", *wish, cwd=tmp_path)
    start = json.loads(moflock.stdout.readline())
    assert start["folder"] is None
    stand_in = subprocess.Popen(
        [sys.executable, STAND_IN, "px4", str(start["ports"][0]), "2"], stdout=subprocess.DEVNULL
    )
    try:
        out, _ = moflock.communicate(timeout=60)
    finally:
        stand_in.kill()
        stand_in.wait()
    assert moflock.returncode == 0
    assert json.loads(out)["time"] == pytest.approx(1.0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["--physics-for", "ardupilot", "--fault", "vehicle=0,at=1,kind=link_loss,share=1"],
            "--fault: it has no effect",
        ),
        (["--physics-for", "px4", "--base-port", "14600"], "--base-port: it has no effect with --physics-for"),
        (["--autopilot-command", "copter"], "--autopilot-command: it has no effect with simulated autopilots"),
        (["--physics-for", "betaflight"], "is not one of 'ardupilot', 'px4'"),
        (["--physics-for", "ardupilot", "--duration", "0"], "duration: 0 s is out of bounds"),
        (
            ["--physics-for", "ardupilot", "--physics-port", "0", "--autopilot-command", "/nowhere/copter {instance}"],
            "autopilot-command: /nowhere/copter: No such file or directory",
        ),
        (["--physics-for", "px4", "--autopilot-command", "px4 {model}"], "placeholder 'model' is unknown"),
    ],
)
def test_bad_wishes_are_refused(arguments, words, tmp_path):
    assert words in refused("fleet", *arguments, cwd=tmp_path)


def test_a_program_that_ends_at_once_is_one_line(tmp_path):
    wish = ["--physics-for", "ardupilot", "--physics-port", "0", "--autopilot-command", "false"]
    done = run("fleet", *wish, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("moflock: autopilot 0: it has ended with status 1: see logs/")
    assert done.stderr.count("\n") == 1
