"""`moflock fly` as a user meets it."""

from __future__ import annotations

import json
import re
import signal

import pytest

from moflock_mj import load_point
from tests.support.cli import refused, run, start_program
from tests.support.waiting import wait_until

QUICK = ("--drones", "3", "--duration", "2", "--log", "none")


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
    shown = json.loads(done.stdout)
    assert shown["complete"]
    assert set(shown["fitness"]) >= {"F_1", "F_2", "product", "speed"}
    logs = list((tmp_path / "logs").iterdir())
    assert [str(log.relative_to(tmp_path)) for log in logs] == [shown["log"]]
    assert logs[0].suffix == ".mcap"


def test_a_point_of_a_file_and_a_scenario_of_a_file(tmp_path):
    (tmp_path / "p.json").write_text(json.dumps(load_point("B")._asdict()))
    (tmp_path / "s.toml").write_text("drones = 4\nduration = 3\narena_side = 100")
    shown = json.loads(
        run("fly", "--dynamics", "point_mass", "--point", "p.json", "--scenario", "s.toml", "--log", "none", "--json",
            cwd=tmp_path).stdout
    )  # fmt: skip
    assert (shown["drones"], shown["duration"]) == (4, 3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--drones", "0"), "drones: 0"),
        (("--drones", "many"), "--drones"),
        pytest.param(("--drones", "2000"), "drones: 2000", marks=pytest.mark.slow),  # it is tried for long
        (("--duration", "nan"), "duration: nan"),
        (("--point", "C"), "point C"),
        (("--point", "absent.json"), "absent.json: No such file"),
        (("--scenario", "absent.toml"), "absent.toml: No such file"),
        (("--airframe", "boeing"), "'boeing'"),
        (("--step", "0.03"), "whole multiple of the step"),
        (("--seed", "-1"), "seed: -1"),
        (("--log", "/proc/none/x.mcap"), "/proc/none"),
        (("--fast",), "--fast"),
        (("--dynamics", "boat"), "boat"),
    ],
)
def test_bad_input_is_one_line_and_status_2(tmp_path, arguments, words):
    assert words in refused("fly", "--duration", "1", *arguments, cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_an_airframe_too_weak_for_a_max_is_refused(tmp_path):
    (tmp_path / "s.toml").write_text("a_max = 30")
    line = refused("fly", "--scenario", "s.toml", *QUICK, cwd=tmp_path)
    assert re.search(r"a_max: 30 m/s\^2 .* x500.* at most", line)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_flight_cleanly(tmp_path, number):
    flight = start_program("fly", "--duration", "100000", "--drones", "5", "--log", "x.mcap", cwd=tmp_path)
    part = tmp_path / "x.mcap.part"
    wait_until(lambda: part.exists() and part.stat().st_size > 100_000, seconds=200)  # some seconds of flight
    flight.send_signal(number)
    stdout, stderr = flight.communicate(timeout=200)
    assert flight.returncode == 130
    assert re.search(r"interrupted at \d+ s of 100000 s", stdout), stdout + stderr
    assert [path.name for path in tmp_path.iterdir()] == ["x.mcap"]
