"""The ground station: where vehicles are, who speaks, what they answer, and flying one from the ground."""

from __future__ import annotations

import asyncio
import math

import pytest

from moflock_mj.errors import CommandError, LinkError
from moflock_mj.ground_station import commands, piloting
from moflock_mj.ground_station.commands import FenceItem
from moflock_mj.ground_station.piloting import FlightTask
from moflock_mj.ground_station.station import GroundStation, vehicles_at
from moflock_mj.mavlink.addresses import Connection, parse_vehicles
from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.mavlink.endpoint import Endpoint
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.simulated_vehicles.fleet import Fleet, FleetPlan
from moflock_mj.simulated_vehicles.vehicle_faults import VehicleFault
from tests.support import simulated_time
from tests.support.ground_station import CALM, fleet_of
from tests.support.simulated_time import Wires, connections_to, flying

KEY = SigningKey(bytes(range(32)))
AUTOPILOTS = ("ardupilot", "px4")


def rehearse(fleet, story, *, count=None, key=None, timeout=10.0):
    """Run a story of (ground, vehicles) with a fleet, in simulated time."""

    async def play():
        async with flying(fleet), vehicles_at(connections_to(fleet), key, count=count, timeout=timeout) as (g, v):
            return await story(g, v)

    with Wires().used():
        return simulated_time.run(play())


@pytest.mark.parametrize(
    ("text", "connections"),
    [
        ("udp:127.0.0.1:14600", [Connection("udpout", "127.0.0.1", 14600)]),
        ("udpout:localhost:5-6", [Connection("udpout", "127.0.0.1", 5), Connection("udpout", "127.0.0.1", 6)]),
        ("udpin:0.0.0.0:14550", [Connection("udpin", "0.0.0.0", 14550)]),
        ("tcp:127.0.0.1:5760-5770", [Connection("tcp", "127.0.0.1", port) for port in (5760, 5770)]),
    ],
)  # fmt: skip
def test_where_vehicles_are(text, connections):
    assert list(parse_vehicles(text)) == connections


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "'' is invalid: it must be KIND:HOST:PORT"),
        ("udp:127.0.0.1", "is invalid"),
        ("serial:/dev/ttyUSB0:57600", "is invalid"),
        ("udp:127.0.0.1:0", "ports.*from 1 to 65535"),
        ("udp:127.0.0.1:70000", "ports must be"),
        ("udp:127.0.0.1:9-8", "the first not above the last"),
        ("tcp:127.0.0.1:5760-5765", "10 apart"),
        ("udp:127.0.0.1:1-300", "300 connections; it must be at most 250"),
        ("udp:127.0.0.1:7,udp:127.0.0.1:6-8", "udpout:127.0.0.1:7 is duplicated"),
    ],
)
def test_a_bad_text(text, words):
    with pytest.raises(LinkError, match=words):
        parse_vehicles(text)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_vehicles_tell_where_they_are(autopilot):
    fleet = fleet_of(autopilot, vehicles=3, spacing=7.0)

    async def story(_, vehicles):
        assert [vehicle.system for vehicle in vehicles] == [1, 2, 3]
        vehicle = vehicles[2]
        assert await commands.set_rates(vehicle, {mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 20}) == []
        await asyncio.sleep(3.0)
        x, y, z = vehicle.position(fleet.plan.origin)
        body = fleet.stations[2].vehicle.body.position
        assert (x, y) == pytest.approx(body[:2], abs=0.02)
        assert z == pytest.approx(body[2], abs=0.01)
        assert vehicle.velocity == pytest.approx((0, 0, 0), abs=0.1)
        assert not vehicle.armed
        assert vehicle.fix_age < 0.07
        assert vehicle.is_local
        assert vehicle.link.rate > 12  # over a window that began before it was asked for
        assert vehicle.link.loss == 0
        assert vehicle.link.round_trip == pytest.approx(0.0, abs=0.03)

    rehearse(fleet, story)


def test_who_is_missing_is_named():
    fleet = fleet_of("px4", vehicles=2, faults=[VehicleFault.from_text("vehicle=1,kind=link_loss,share=1")])

    async def story(*_):
        raise AssertionError

    with pytest.raises(LinkError, match=r"from 1 of 2 links within 3 s: udpout:127.0.0.1:14601$"):
        rehearse(fleet, story, timeout=3.0)


def test_more_than_wanted_is_refused():
    async def story(*_):
        raise AssertionError

    with pytest.raises(LinkError, match=r"2 connected \(system ids 1, 2\).*1"):
        rehearse(fleet_of("px4", vehicles=2), story, count=1)


def test_links_that_are_not_signed_tell_why_nobody_is_heard():
    """A signed fleet answers no stranger; one that signs hears of what it drops."""

    async def story(*_):
        raise AssertionError

    with pytest.raises(LinkError, match=r"packets were unsigned"):
        rehearse(fleet_of("px4"), story, key=KEY, timeout=2.0)


def test_a_duplicated_system_id():
    fleet = fleet_of("px4", vehicles=2, faults=[VehicleFault.from_text("vehicle=1,kind=duplicate_id,system=1")])

    async def story(*_):
        raise AssertionError

    with pytest.raises(LinkError, match=r"system id 1 is used by 127.0.0.1:1460\d and 127.0.0.1:1460\d"):
        rehearse(fleet, story)


def test_several_on_a_link_must_have_been_counted():
    """Else one that is heard a moment later would fly unseen among the others."""
    fleet = fleet_of("ardupilot", vehicles=3, to=("127.0.0.1", 14550))

    async def play():
        async with flying(fleet), vehicles_at([Connection("udpin", "127.0.0.1", 14550)]):
            raise AssertionError

    words = r"3 connected \(system ids 1, 2, 3\).*1, one on each link: several on one link need --count"
    with Wires().used(), pytest.raises(LinkError, match=words):
        simulated_time.run(play())


def test_vehicles_that_speak_first_share_a_link():
    """As real ones do at udpin:14550, or behind a router: distinguished by system id alone."""
    fleet = fleet_of("ardupilot", vehicles=3, to=("127.0.0.1", 14550))

    async def play():
        async with (
            flying(fleet),
            vehicles_at([Connection("udpin", "127.0.0.1", 14550)], count=3) as (ground, vehicles),
        ):
            assert [vehicle.where for vehicle in vehicles] == [f"127.0.0.1:{14600 + i}" for i in range(3)]
            assert await commands.read_parameter(vehicles[1], "SYSID_THISMAV") == commands.Parameter(4, 2.0)
            return ground.counts()

    with Wires().used():
        assert simulated_time.run(play()).dropped == 0


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_parameters_are_set_and_read_back(autopilot):
    whole, real = ("RTL_ALT", "WPNAV_SPEED") if autopilot == "ardupilot" else ("NAV_DLL_ACT", "MPC_XY_VEL_MAX")
    fleet = fleet_of(autopilot)

    async def story(_, vehicles):
        (vehicle,) = vehicles
        assert (await commands.set_parameter(vehicle, whole, 3)).value == 3
        assert (await commands.set_parameter(vehicle, real, 7.3)).value == 7.3
        assert await commands.read_parameter(vehicle, "NO_SUCH_THING", tries=1) is None
        with pytest.raises(CommandError, match="NO_SUCH_THING: no answer"):
            await commands.set_parameter(vehicle, "NO_SUCH_THING", 1)
        with pytest.raises(CommandError, match=r"0.5 was set, but it keeps"):
            await commands.set_parameter(vehicle, whole, 0.5)

    rehearse(fleet, story)
    parameters = fleet.stations[0].vehicle.parameters
    assert parameters[real] == pytest.approx(7.3)


@pytest.mark.parametrize("fault", [None, "vehicle=0,kind=link_loss,share=0.3", "vehicle=0,kind=link_delay,delay=0.5"])
def test_a_fence_goes_up_and_comes_down_by_a_bad_link_too(fault):
    fleet = fleet_of("px4", faults=[VehicleFault.from_text(fault)] if fault else [])
    corners = [(47.0, 8.0), (47.0, 8.1), (47.1, 8.1), (47.1, 8.0), (47.05, 7.9)]
    fence = [
        *(FenceItem(mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, 5, *corner) for corner in corners),
        FenceItem(mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, 20, 47.05, 8.05),
    ]

    async def story(_, vehicles):
        await commands.upload_fence(vehicles[0], fence)
        assert await commands.download_fence(vehicles[0]) == fence

    rehearse(fleet, story)
    assert len(fleet.stations[0].vehicle.shapes) == 2


def test_a_fence_that_is_none_is_refused():
    async def story(_, vehicles):
        with pytest.raises(CommandError, match="fence: refused"):
            await commands.upload_fence(vehicles[0], [FenceItem(16, 0, 47.0, 8.0)])

    rehearse(fleet_of("px4"), story)


def test_messages_are_asked_for():
    async def story(_, vehicles):
        version = await commands.request_message(vehicles[0], mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        await commands.request_message(vehicles[0], mavlink.MAVLINK_MSG_ID_HOME_POSITION)
        latitude, longitude, altitude = vehicles[0].home()
        assert (latitude, longitude) == pytest.approx((47.397742, 8.545594), abs=1e-5)
        assert altitude == pytest.approx(488, abs=1)

    rehearse(fleet_of("ardupilot"), story)


@pytest.mark.parametrize("loss", [0.0, 0.3])
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_vehicle_flies_by_what_its_heartbeat_says(autopilot, loss):
    fleet = fleet_of(autopilot, faults=[VehicleFault.from_text(f"vehicle=0,kind=link_loss,share={loss}")])

    async def stream(vehicle, velocity):
        while True:
            vehicle.send(piloting.velocity_setpoint(vehicle.system, velocity))
            await asyncio.sleep(0.05)

    async def story(_, vehicles):
        (vehicle,) = vehicles
        await commands.set_rates(vehicle, {mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 20,
                                         mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5})  # fmt: skip
        await asyncio.sleep(1.0)
        await piloting.take_off(vehicle, 8.0)
        while vehicle.fix.height < 7.5:
            await asyncio.sleep(0.1)
        streaming = asyncio.create_task(stream(vehicle, (3.0, 0.0, 0.0)))
        await asyncio.sleep(piloting.STREAM_FIRST)
        await piloting.begin(vehicle, FlightTask.OFFBOARD)
        await asyncio.sleep(4.0)
        assert vehicle.velocity[0] == pytest.approx(3.0, abs=0.3)
        await piloting.begin(vehicle, FlightTask.HOLD)
        streaming.cancel()
        await asyncio.sleep(5.0)
        assert math.hypot(*vehicle.velocity[:2]) < 0.3
        await piloting.begin(vehicle, FlightTask.LAND)
        while vehicle.armed:
            await asyncio.sleep(0.1)
        assert vehicle.landed

    rehearse(fleet, story)


def test_what_a_vehicle_says_when_it_does_not_arm():
    fleet = fleet_of("px4", ready=False, boot=100.0)

    async def story(_, vehicles):
        with pytest.raises(CommandError, match="does not arm: it reports Arming denied: Resolve system health"):
            await piloting.arm(vehicles[0], timeout=2.0)

    rehearse(fleet, story)


def test_what_a_vehicle_has_said_before_is_no_reason():
    fleet = fleet_of("px4", ready=False, boot=100.0)

    async def story(_, vehicles):
        fleet.stations[0].vehicle.say("Failsafe cleared", mavlink.MAV_SEVERITY_WARNING)
        await asyncio.sleep(1.0)
        with pytest.raises(CommandError) as raised:
            await piloting.set_mode(vehicles[0], 99, timeout=2.0)
        assert "although 99 was requested" in str(raised.value)
        assert "cleared" not in str(raised.value)

    rehearse(fleet, story)


def test_heartbeats_stop_when_the_controller_says_so():
    fleet = fleet_of("px4")

    async def story(ground, _):
        await asyncio.sleep(3.0)
        ground.heartbeats_enabled = False
        await asyncio.sleep(5.0)
        return fleet.stations[0].vehicle

    vehicle = rehearse(fleet, story)
    assert vehicle.time - vehicle.ground_heard == pytest.approx(5.0, abs=1.05)


def test_sockets_and_a_stream():
    """Real sockets: a fleet on loopback, and the same bytes by TCP."""

    async def serve(reader, writer):
        vehicle = Endpoint(9, lambda *_: None)
        peer = vehicle.peer(("tcp", 0))
        beat = mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 3, 3)
        packets = b"".join(vehicle.pack(beat, peer) for _ in range(20))
        try:
            for offset in range(0, len(packets), 7):  # cut anywhere, with rubbish between
                writer.write(packets[offset : offset + 7] + (b"rubbish" if offset % 147 == 0 and offset else b""))
                await writer.drain()
            await reader.read()
        finally:
            writer.close()

    async def play():
        server = await asyncio.start_server(serve, "127.0.0.1", 0)
        fleet = Fleet(FleetPlan(base_port=0, vehicles=1, boot=0.0, scenario=CALM))
        await fleet.open()
        flight = asyncio.create_task(fleet.run())
        try:
            connections = [
                Connection("udpout", *fleet.stations[0].address),
                Connection("tcp", *server.sockets[0].getsockname()),
            ]
            async with GroundStation(connections) as ground:
                vehicles = await ground.connect()
                return [vehicle.system for vehicle in vehicles], vehicles[1].link.received
        finally:
            flight.cancel()
            fleet.close()
            server.close()

    systems, received = asyncio.run(play())
    assert systems == [1, 9]
    assert received >= 15


def test_nobody_listens_at_a_stream():
    async def play():
        async with GroundStation([Connection("tcp", "127.0.0.1", 1)]):
            raise AssertionError

    with pytest.raises(LinkError, match=r"TCP 127\.0\.0\.1:1: "):
        asyncio.run(play())
