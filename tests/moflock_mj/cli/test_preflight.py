"""The command `moflock preflight` against fleets in processes of their own, over real sockets."""

from __future__ import annotations

import json
import socket

import pytest

from moflock_mj import load_point
from moflock_mj.mavlink.signing import KEY_VARIABLE, SigningKey
from moflock_mj.preflight.report import read_report
from tests.support.cli import refused, run
from tests.support.vehicles import free_ports, running_fleet

FIELD = "arena_side = 200.0\nduration = 2.0\nt_del = 0.2\n"
KEY = "f0" * 32


@pytest.fixture(autouse=True)
def field(tmp_path):
    (tmp_path / "field.toml").write_text(FIELD)


@pytest.mark.slow
@pytest.mark.parametrize(("autopilot", "key"), [("ardupilot", None), ("px4", KEY)])
def test_a_fleet_is_put_right_and_its_report_signed_off(tmp_path, autopilot, key):
    port = free_ports(3)
    vehicles = f"udp:127.0.0.1:{port}-{port + 2}"
    fleet = ("--vehicles", "3", "--autopilot", autopilot, "--base-port", str(port))
    with running_fleet(tmp_path, *fleet, key=key):
        asked = ("preflight", "knee", "--scenario", "field.toml", "--vehicles", vehicles, "--flights", "1")
        known = {KEY_VARIABLE: key} if key else {}
        found = run(*asked, "--json", "--out", "found.json", cwd=tmp_path, **known)
        fixed = run(*asked, "--fix", "--signed-off-by", "Ada", cwd=tmp_path, **known)
    assert (found.returncode, fixed.returncode, fixed.stderr) == (1, 0, "")
    shown = json.loads(found.stdout)
    assert shown["verdict"] == "failure"
    assert all(item["advice"] for item in shown["items"] if item["result"] == "failure")
    (path,) = (tmp_path / "logs").glob("preflight-*-knee.json")
    report = read_report(path, SigningKey.from_text(key, "") if key else None)
    assert report.verdict == "pass"
    assert report.signed_off_by == "Ada"
    assert report.params() == load_point("knee")
    assert [vehicle.where for vehicle in report.vehicles] == [f"127.0.0.1:{port + number}" for number in range(3)]
    assert report.changes
    assert all(change.split(":")[0] in fixed.stdout for change in report.changes)
    assert "signed off by Ada" in fixed.stdout


def test_without_vehicles_and_with_a_point_that_fails(tmp_path):
    point = load_point("knee")._asdict() | {"r0_frict": 1.0, "p_rep": 3.0}
    (tmp_path / "bad.json").write_text(json.dumps(point))
    wish = ("bad.json", "--scenario", "field.toml", "--drones", "3", "--flights", "0")
    asked = run("preflight", *wish, cwd=tmp_path)
    assert asked.returncode == 1
    assert "alignment begins outside repulsion" in " ".join(asked.stdout.split())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nonsense"], "point"),
        (["knee", "--scenario", "none.toml"], "none.toml"),
        (["knee", "--vehicles", "udp:127.0.0.1"], "KIND:HOST:PORT"),
        (["knee", "--vehicles", "tcp:127.0.0.1:1", "--timeout", "0.2"], "TCP 127.0.0.1:1"),
        (["knee", "--vehicles", "udp:127.0.0.1:9", "--timeout", "0.2"], "no heartbeat of an autopilot from 1 of 1"),
        (["knee", "--vehicles", "udpin:127.0.0.1:{taken}"], "{taken}"),
        (["knee", "--vehicles", "udp:127.0.0.1:9", "--flights", "0"], "flights: 0"),
        (["knee", "--vehicles", "udp:127.0.0.1:9", "--autopilot", "betaflight"], "betaflight"),
        (["knee", "--vehicles", "udp:127.0.0.1:9", "--key-file", "none"], "key file none"),
        (["knee", "--fix"], "without --vehicles"),
        (["knee", "--flights", "-1"], "flights"),
    ],
)
def test_bad_use_is_one_line_and_writes_nothing(tmp_path, arguments, words):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = str(taken.getsockname()[1])
        filled = [argument.replace("{taken}", port) for argument in arguments]
        line = refused("preflight", *filled, cwd=tmp_path)
    assert words.replace("{taken}", port) in line
    assert not (tmp_path / "logs").exists()
