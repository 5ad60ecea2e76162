"""A fleet as a whole: its plan and its sockets."""

from __future__ import annotations

import asyncio
import socket

import pytest

from moflock_mj.errors import LinkError
from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.mavlink.endpoint import Endpoint
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.simulated_vehicles.fleet import Fleet, FleetPlan
from tests.support.ground_station import CALM, GroundStation, fleet_of

KEY = SigningKey(bytes(range(32)))


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        ({"vehicles": 0}, "vehicles: 0.*from 1 to 250"),
        ({"vehicles": 251}, "vehicles: 251"),
        ({"autopilot": "paparazzi"}, "ardupilot, px4"),
        ({"base_port": 65535, "vehicles": 2}, "base_port: 65535.*from 0 to 65534"),
        ({"speed": float("nan")}, "speed: nan"),
        ({"speed": 0}, "speed: 0 is out of bounds"),
        ({"boot": -1}, "boot: -1"),
        ({"spacing": 0.7}, "spacing: 0.7 m.*the airframe's 0.754 m"),
        ({"scenario": CALM.replace(step=0.0125)}, "step: 0.0125 s must go a whole number of times"),
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
            await asyncio.sleep(0)  # the loop closes a socket in its next round
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free_again:
                free_again.bind(("127.0.0.1", port - 1))

    asyncio.run(rehearse())
