"""`moflock fleet --physics-for`: programs that it starts, ones that come by themselves, and bad wishes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer

from moflock_mj.cli.app import make_app
from moflock_mj.errors import MoflockError

MOFLOCK = Path(sys.executable).parent / "moflock"
STAND_IN = Path(__file__).parents[2] / "support" / "autopilot_stand_in.py"
CALM = "sigma_inner = 0.0\nsigma_outer = 0.0\n"


def started(*arguments, cwd):
    return subprocess.Popen(
        [MOFLOCK, "fleet", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        env={**os.environ, "COLUMNS": "200"},
    )


def alive(words):
    """Whether a process has these in its command line, where words are parted by zeros."""
    commands = (path.read_bytes() for path in Path("/proc").glob("[0-9]*/cmdline") if os.access(path, os.R_OK))
    return any(words.encode() in command for command in commands)


def test_it_flies_programs_and_ends_them_with_ctrl_c(tmp_path):
    (tmp_path / "calm.toml").write_text(CALM)
    command = f"{sys.executable} {STAND_IN} ardupilot {{port}} {{sysid}} --of {tmp_path}"
    moflock = started(
        "--physics-for", "ardupilot", "--vehicles", 2, "--physics-port", 0, "--scenario", "calm.toml", "--json",
        "--speed", 100, "--autopilot-command", command, cwd=tmp_path,
    )  # fmt: skip
    start = json.loads(moflock.stdout.readline())
    assert start["physics_for"] == "ardupilot"
    assert len(set(start["ports"])) == 2
    assert "2 ardupilot autopilots connected" in moflock.stderr.readline()
    assert alive(f"--of\0{tmp_path}")
    time.sleep(1.0)
    moflock.send_signal(signal.SIGINT)
    out, err = moflock.communicate(timeout=60)
    end = json.loads(out)
    assert (moflock.returncode, err) == (0, "")
    assert end["present"] == 2
    assert end["time"] > 0
    assert end["received"] >= 2 * round(end["time"] * 1200)
    assert not alive(f"--of\0{tmp_path}")
    for number, port in enumerate(start["ports"]):
        output = tmp_path / start["folder"] / str(number) / "output.txt"
        assert output.read_text() == f"stand-in of ardupilot at {port}\n"


def test_it_waits_for_programs_that_the_user_starts(tmp_path):
    moflock = started(
        "--physics-for", "px4", "--physics-port", 0, "--duration", 1, "--json", "--speed", 100, cwd=tmp_path
    )
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
def test_bad_wishes_are_refused(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((MoflockError, typer.TyperException), match=words):
        make_app()(["fleet", *arguments], standalone_mode=False)


def test_a_program_that_ends_at_once_is_told_in_one_line(tmp_path):
    wish = ["--physics-for", "ardupilot", "--physics-port", "0", "--autopilot-command", "false"]
    moflock = started(*wish, cwd=tmp_path)
    _, err = moflock.communicate(timeout=60)
    assert moflock.returncode == 2
    assert err.startswith("moflock: autopilot 0: its program ended with status 1: see logs/")
    assert len(err.splitlines()) == 1
