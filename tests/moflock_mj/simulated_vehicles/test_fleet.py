"""A fleet as a whole: its plan, its sockets, its verb."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from moflock_mj.errors import LinkError
from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.mavlink.endpoint import Endpoint
from moflock_mj.mavlink.signing import KEY_VARIABLE, SigningKey
from moflock_mj.simulated_vehicles.fleet import Fleet, FleetPlan
from tests.support.ground_station import CALM, GroundStation, fleet_of

MOFLOCK = Path(sys.executable).parent / "moflock"
KEY = SigningKey(bytes(range(32)))


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        ({"vehicles": 0}, "vehicles: 0 is out of bounds: it must be from 1 to 250"),
        ({"vehicles": 251}, "vehicles: 251"),
        ({"autopilot": "paparazzi"}, "it must be one of ardupilot, px4"),
        ({"base_port": 65535, "vehicles": 2}, "base_port: 65535 is out of bounds: it must be from 0 to 65534"),
        ({"speed": float("nan")}, "speed: nan"),
        ({"speed": 0}, "speed: 0 is out of bounds"),
        ({"boot": -1}, "boot: -1"),
        ({"spacing": 0.7}, "spacing: 0.7 m: it must be above the airframe's diameter, 0.754 m"),
        ({"scenario": CALM.replace(step=0.0125)}, "step: 0.0125 s: it must divide 0.02 s"),
    ],
)
def test_a_bad_plan(plan, words):
    with pytest.raises(Exception, match=words):
        Fleet(FleetPlan(**plan))


def test_vehicles_stand_apart_and_have_ids_and_ports_of_their_own():
    fleet = fleet_of("ardupilot", vehicles=7, spacing=3.0)
    places = [station.vehicle.body.position for station in fleet.stations]
    assert len({place[:2] for place in places}) == 7
    assert min(abs(a[0] - b[0]) + abs(a[1] - b[1]) for a in places for b in places if a != b) == pytest.approx(3.0)
    assert [station.vehicle.system for station in fleet.stations] == list(range(1, 8))


def test_several_vehicles_take_off_at_once():
    fleet = fleet_of("px4", vehicles=4)
    stations = [GroundStation(fleet, number) for number in range(4)]
    for station in stations:
        station.arm()
        station.command(mavlink.MAV_CMD_NAV_TAKEOFF, *[float("nan")] * 7)
    stations[0].wait(6.0)
    assert all(station.vehicle.height() > 2.0 for station in stations)
    state = fleet.state()
    assert (state.armed, state.flying, state.modes) == (4, 4, {"HOLD": 4})


def test_sockets_speed_and_signatures():
    """Ten simulated seconds at ten times real time; a stranger without the key hears nothing."""

    async def rehearse():
        fleet = Fleet(FleetPlan(autopilot="px4", base_port=0, speed=10.0, boot=1.0, vehicles=2), KEY)
        await fleet.open()
        heard, overheard = [], []
        friend = Endpoint(255, lambda message, _: heard.append(message), component=190, key=KEY)
        stranger = Endpoint(254, lambda message, _: overheard.append(message), component=190)
        try:
            for endpoint in (friend, stranger):
                await endpoint.open()
                beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
                endpoint.send(beat, endpoint.peer(fleet.stations[1].address))
            began = asyncio.get_running_loop().time()
            await fleet.run(10.0)
            seconds = asyncio.get_running_loop().time() - began
        finally:
            for endpoint in (friend, stranger, fleet):
                endpoint.close()
        return fleet, heard, overheard, seconds

    fleet, heard, overheard, seconds = asyncio.run(rehearse())
    assert seconds >= 0.99
    assert fleet.time == pytest.approx(10.0)
    assert {message.get_srcSystem() for message in heard} == {2}
    assert len([message for message in heard if message.get_type() == "HEARTBEAT"]) >= 10
    assert overheard == []
    assert fleet.stations[1].endpoint.counts.unsigned == 1
    assert fleet.state().dropped == 1


def test_a_port_in_use_leaves_none_open():
    async def rehearse():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", 0))
            port = taken.getsockname()[1]
            fleet = Fleet(FleetPlan(base_port=port - 1, vehicles=2))
            with pytest.raises(LinkError, match=f"UDP 127.0.0.1:{port}: "):
                await fleet.open()
            assert fleet.stations[0].endpoint._transport is None

    asyncio.run(rehearse())


def run(*arguments, cwd=None, **environment):
    clean = {name: value for name, value in os.environ.items() if name != KEY_VARIABLE}
    return subprocess.run(
        [MOFLOCK, "fleet", *map(str, arguments)], capture_output=True, text=True, cwd=cwd, timeout=300, check=False,
        env={**clean, "COLUMNS": "200", **environment},
    )  # fmt: skip


def test_the_verb_prints_its_endpoints_and_ends_with_its_time():
    done = run("--vehicles", 2, "--base-port", 0, "--duration", 1, "--speed", 5)
    assert done.returncode == 0, done.stderr
    assert "udpout://127.0.0.1:" in done.stdout
    assert "2 x500 as ardupilot, links not signed" in done.stdout
    assert "1.0 s simulated" in done.stdout
    assert done.stderr == ""


def test_the_verb_speaks_json_and_takes_its_key_from_the_environment():
    done = run("--base-port", 0, "--duration", 1, "--speed", 5, "--json", **{KEY_VARIABLE: "correct horse"})
    first, last = map(json.loads, done.stdout.splitlines())
    assert first["signed"]
    assert [vehicle["system"] for vehicle in first["vehicles"]] == [1]
    assert last["time"] == pytest.approx(1.0)
    assert set(last) >= {field.name for field in dataclasses.fields(type(fleet_of("px4").state()))}
    assert "horse" not in done.stdout + done.stderr


def test_ctrl_c_ends_the_fleet():
    fleet = subprocess.Popen(
        [MOFLOCK, "fleet", "--base-port", "0", "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
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
            (("--fault", "vehicle=9,kind=link_loss,share=1"), "vehicle 9 is out of bounds"),
            (("--key-file", "open.key"), "permissions 644: they must be 600"),
            (("--base-port", taken.getsockname()[1]), "in use"),
            (("--to", "nowhere"), "must be HOST:PORT"),
        )
        for arguments, words in cases:
            done = run(*arguments, cwd=tmp_path)
            assert done.returncode == 2, arguments
            assert words in done.stderr
            assert done.stderr.count("\n") == 1
            assert done.stdout == ""
