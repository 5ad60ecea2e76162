"""`moflock fleet` as a user meets it."""

from __future__ import annotations

import dataclasses
import json
import signal
import socket

import pytest

from moflock_mj.mavlink.signing import KEY_VARIABLE
from tests.support.cli import refused, run, start_program
from tests.support.ground_station import fleet_of


def test_the_command_prints_its_endpoints_and_ends_with_its_time():
    done = run("fleet", "--vehicles", 2, "--base-port", 0, "--duration", 1, "--speed", 5)
    assert done.returncode == 0, done.stderr
    assert "udpout://127.0.0.1:" in done.stdout
    assert "2 x500 as ardupilot, links not signed" in done.stdout
    assert "1.0 s simulated" in done.stdout
    assert done.stderr == ""


def test_the_command_speaks_json_and_takes_its_key_from_the_environment():
    done = run("fleet", "--base-port", 0, "--duration", 1, "--speed", 5, "--json", **{KEY_VARIABLE: "correct horse"})
    first, last = map(json.loads, done.stdout.splitlines())
    assert first["signed"]
    assert [vehicle["system"] for vehicle in first["vehicles"]] == [1]
    assert last["time"] == pytest.approx(1.0)
    assert set(last) >= {field.name for field in dataclasses.fields(type(fleet_of("px4").state()))}
    assert "horse" not in done.stdout + done.stderr


@pytest.mark.slow
def test_ctrl_c_ends_the_fleet():
    fleet = start_program("fleet", "--base-port", "0", "--json")
    assert json.loads(fleet.stdout.readline())["vehicles"]
    fleet.send_signal(signal.SIGINT)
    stdout, stderr = fleet.communicate(timeout=60)
    assert fleet.returncode == 0, stderr
    assert json.loads(stdout)["time"] >= 0
    assert stderr == ""


def test_bad_input_is_one_line_and_status_2(tmp_path):
    (tmp_path / "open.key").write_text("correct horse battery staple")
    (tmp_path / "open.key").chmod(0o644)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        cases = (
            (("--fault", "vehicle=9,kind=link_loss,share=1"), "vehicle 9"),
            (("--key-file", "open.key"), "644"),
            (("--base-port", taken.getsockname()[1]), "in use"),
            (("--to", "nowhere"), "HOST:PORT"),
        )
        for arguments, words in cases:
            assert words in refused("fleet", *arguments, cwd=tmp_path)
