"""The command line as a user meets it."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from moflock_mj import load_point

MOFLOCK = Path(sys.executable).parent / "moflock"
QUICK = ("--drones", "3", "--duration", "2", "--log", "none")


def run(*arguments, cwd=None, **environment):
    return subprocess.run(
        [MOFLOCK, *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        timeout=300,
        env={**os.environ, "COLUMNS": "120", **environment},
        check=False,
    )


def test_help_names_the_verbs_and_each_verb_has_an_example():
    assert "fly" in run("--help").stdout
    assert "Example: moflock fly" in run("fly", "--help").stdout


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body"])
def test_fly_prints_tables(dynamics):
    done = run("fly", "--dynamics", dynamics, *QUICK)
    assert done.returncode == 0, done.stderr
    for word in ("phi_cluster", "F_1", "product"):
        assert word in done.stdout
    assert ("largest tilt" in done.stdout) == (dynamics == "rigid_body")
    assert done.stderr == ""


def test_fly_prints_json_and_logs(tmp_path):
    done = run("fly", *QUICK[:4], "--dynamics", "point_mass", "--json", cwd=tmp_path)
    told = json.loads(done.stdout)
    assert told["complete"]
    assert set(told["fitness"]) >= {"F_1", "F_2", "product", "speed"}
    logs = list((tmp_path / "logs").iterdir())
    assert [str(log.relative_to(tmp_path)) for log in logs] == [told["log"]]
    assert logs[0].suffix == ".mcap"


def test_a_point_of_a_file_and_a_scenario_of_a_file(tmp_path):
    (tmp_path / "p.json").write_text(json.dumps(load_point("B")._asdict()))
    (tmp_path / "s.toml").write_text("drones = 4\nduration = 3\narena_side = 100")
    told = json.loads(
        run("fly", "--dynamics", "point_mass", "--point", "p.json", "--scenario", "s.toml", "--log", "none", "--json",
            cwd=tmp_path).stdout
    )  # fmt: skip
    assert (told["drones"], told["duration"]) == (4, 3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--drones", "0"), "drones: 0 is out of bounds"),
        (("--drones", "many"), "--drones"),
        (("--drones", "2000"), "drones: 2000 do not fit"),
        (("--duration", "nan"), "duration: nan"),
        (("--point", "C"), "point C: unknown"),
        (("--point", "absent.json"), "absent.json: No such file"),
        (("--scenario", "absent.toml"), "absent.toml: No such file"),
        (("--airframe", "boeing"), "'boeing' is unknown"),
        (("--step", "0.03"), "must be a whole multiple of the step"),
        (("--seed", "-1"), "seed: -1"),
        (("--log", "/proc/none/x.mcap"), "/proc/none"),
        (("--fast",), "--fast"),
        (("--dynamics", "boat"), "boat"),
    ],
)
def test_bad_input_is_one_line_and_status_2(tmp_path, arguments, words):
    done = run("fly", "--duration", "1", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_an_airframe_too_weak_for_a_max_is_refused(tmp_path):
    (tmp_path / "s.toml").write_text("a_max = 30")
    done = run("fly", "--scenario", "s.toml", *QUICK, cwd=tmp_path)
    assert done.returncode == 2
    assert re.search(r"a_max: 30 m/s\^2 .* x500.* at most", done.stderr)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_flight_cleanly(tmp_path, number):
    flight = subprocess.Popen(
        [MOFLOCK, "fly", "--duration", "100000", "--drones", "5", "--log", "x.mcap"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
    )  # fmt: skip
    deadline = time.monotonic() + 200
    while not (tmp_path / "x.mcap.part").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    time.sleep(1.0)
    flight.send_signal(number)
    stdout, stderr = flight.communicate(timeout=200)
    assert flight.returncode == 130
    assert re.search(r"interrupted at \d+ s of 100000 s", stdout), stdout + stderr
    assert [path.name for path in tmp_path.iterdir()] == ["x.mcap"]


def test_help_imports_nothing_heavy():
    code = "import sys, moflock_mj.cli.app; print([m for m in ('numpy', 'numba', 'mujoco') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
