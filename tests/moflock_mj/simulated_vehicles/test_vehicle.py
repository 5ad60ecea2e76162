"""What both autopilots do alike: take off, fly, hold, return, land, and answer."""

from __future__ import annotations

import math
import struct

import pytest

from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.mavlink.frames import ned_of_world
from moflock_mj.simulated_vehicles.ardupilot import GUIDED, RTL
from moflock_mj.simulated_vehicles.fleet import AUTOPILOTS, TICK
from moflock_mj.simulated_vehicles.px4 import OFFBOARD, RETURN
from moflock_mj.simulated_vehicles.vehicle import Phase
from moflock_mj.simulated_vehicles.vehicle_faults import VehicleFault
from tests.support.ground_station import CALM, GroundStation, fleet_of, velocity

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
OBEDIENT = {"ardupilot": GUIDED, "px4": OFFBOARD}


@pytest.fixture(params=sorted(AUTOPILOTS))
def autopilot(request):
    return request.param


@pytest.fixture
def station(autopilot):
    return GroundStation(fleet_of(autopilot))


def obey(station, autopilot, setpoint):
    """Bring a vehicle in the air into the mode in which it takes setpoints."""
    station.wait(0.2, setpoint)
    assert station.mode(OBEDIENT[autopilot]) == ACCEPTED


def test_it_stands_still_until_it_is_armed(station):
    place = station.vehicle.body.position
    station.wait(2.0)
    assert station.vehicle.body.position == pytest.approx(place, abs=1e-3)
    assert station.vehicle.phase == Phase.GROUND


def test_it_takes_off_flies_a_velocity_and_lands_softly(station, autopilot):
    station.take_off(5.0)
    setpoint = velocity(2.0, -1.0, -0.5)
    obey(station, autopilot, setpoint)
    station.wait(5.0, setpoint)
    assert ned_of_world(station.vehicle.body.velocity) == pytest.approx((2.0, -1.0, -0.5), abs=0.1)
    assert station.command(mavlink.MAV_CMD_NAV_LAND) == ACCEPTED
    falls = []
    assert station.wait(40, until=lambda: falls.append(station.vehicle.body.velocity[2]) or not station.vehicle.armed)
    assert station.vehicle.phase == Phase.GROUND
    assert min(falls[-100:]) > -0.8
    assert station.vehicle.body.upright > 0.999


def test_a_velocity_in_the_bodys_frame(station, autopilot):
    """Our vehicles face east: forward is east, right is south."""
    station.take_off(5.0)
    setpoint = velocity(1.0, 2.0, 0.0, frame=mavlink.MAV_FRAME_BODY_NED, mask=4039)
    obey(station, autopilot, setpoint)
    station.wait(6.0, setpoint)
    assert station.vehicle.body.velocity == pytest.approx((1.0, -2.0, 0.0), abs=0.1)


def test_a_place_in_its_own_frame(station, autopilot):
    station.take_off(5.0)
    setpoint = mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, mavlink.MAV_FRAME_LOCAL_NED, 0xDF8, 6.0, -3.0, -8.0, 0, 0, 0, 0, 0, 0, 0, 0
    )
    obey(station, autopilot, setpoint)
    station.wait(30.0, setpoint)
    x, y, z = station.vehicle.local_origin
    assert station.vehicle.body.position == pytest.approx((x - 3.0, y + 6.0, z + 8.0), abs=0.2)


def test_it_returns_home_and_lands(station, autopilot):
    station.take_off(5.0)
    home = station.vehicle.home
    setpoint = velocity(4.0, 0.0, 0.0)
    obey(station, autopilot, setpoint)
    station.wait(10.0, setpoint)
    assert math.dist(station.vehicle.body.position, home) > 20
    for name in ("RTL_RETURN_ALT",):
        if name in station.vehicle.parameters:
            station.set_parameter(name, 20.0)
    assert station.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    assert station.vehicle.mode in (RTL, RETURN)
    heights = []
    assert station.wait(120, until=lambda: heights.append(station.vehicle.height()) or not station.vehicle.armed)
    assert max(heights) == pytest.approx(15.0 if autopilot == "ardupilot" else 20.0, abs=0.6)
    assert station.vehicle.body.position == pytest.approx(home, abs=0.5)


def test_it_is_disarmed_in_the_air_by_force_only(station):
    station.take_off(3.0)
    disarm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
    assert station.command(disarm, 0) != ACCEPTED
    assert station.vehicle.armed
    assert station.command(disarm, 0, 21196) == ACCEPTED
    station.wait(3.0)
    assert station.vehicle.body.position[2] < 0.2


def test_an_armed_vehicle_that_does_not_take_off_disarms(station, autopilot):
    if autopilot == "ardupilot":
        station.mode(GUIDED)
    assert station.arm() == ACCEPTED
    station.wait(9.0)
    assert station.vehicle.armed
    station.wait(2.0)
    assert not station.vehicle.armed


def test_an_empty_battery_lets_it_fall(station):
    station.take_off(3.0)
    station.vehicle.battery.set_remaining(0.0)
    station.wait(3.0)
    assert station.vehicle.body.position[2] < 0.3


def test_a_lost_rotor_is_a_crash(autopilot):
    fault = VehicleFault.from_text("vehicle=0,at=12,kind=rotor_failure,rotor=2")
    station = GroundStation(fleet_of(autopilot, faults=[fault]))
    station.take_off(8.0)
    assert station.wait(10.0, until=lambda: not station.vehicle.armed)
    assert "Crash: Disarming" in station.texts()


def test_telemetry_says_where_it_is(station, autopilot):
    for number in (30, 32, 33, 242, 245):
        station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 20_000)
    station.take_off(5.0)
    setpoint = velocity(3.0, 1.0, 0.0)
    obey(station, autopilot, setpoint)
    station.wait(5.0, setpoint)
    body, origin = station.vehicle.body, station.vehicle.local_origin
    local, globe, home = map(station.latest, ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "HOME_POSITION"))
    offset = tuple(here - there for here, there in zip(body.position, origin, strict=True))
    assert (local.x, local.y, local.z) == pytest.approx(ned_of_world(offset), abs=1e-4)
    assert (local.vx, local.vy, local.vz) == pytest.approx(ned_of_world(body.velocity), abs=1e-4)
    place = station.vehicle.origin.world(globe.lat / 1e7, globe.lon / 1e7)
    assert place == pytest.approx(body.position[:2], abs=0.02)
    assert globe.relative_alt / 1000 == pytest.approx(station.vehicle.height(), abs=1e-3)
    assert (globe.vx, globe.vy, globe.hdg) == (round(local.vx * 100), round(local.vy * 100), 9000)
    assert (home.x, home.y, home.z) == pytest.approx((0, 0, 0), abs=0.01)
    assert station.latest("ATTITUDE").yaw == pytest.approx(math.pi / 2, abs=0.01)
    assert station.latest("ATTITUDE").pitch < 0.05
    assert station.latest("EXTENDED_SYS_STATE").landed_state == mavlink.MAV_LANDED_STATE_IN_AIR


def test_leaning_forward_is_a_negative_pitch(station, autopilot):
    station.take_off(5.0)
    station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 30, 20_000)
    setpoint = velocity(0.0, 5.0, 0.0)
    obey(station, autopilot, setpoint)
    station.wait(0.6, setpoint)
    assert station.latest("ATTITUDE").pitch < -0.1
    assert abs(station.latest("ATTITUDE").roll) < 0.02


def test_messages_come_at_the_rates_that_were_asked_for(station):
    for number, rate in ((32, 50), (33, 10), (245, 1)):
        station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate)
    station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 30, -1)
    station.wait(1.0)
    station.received.clear()
    station.wait(10.0)
    counts = {kind: len(messages) for kind, messages in station.received.items()}
    assert counts["HEARTBEAT"] in (10, 11)
    assert counts["LOCAL_POSITION_NED"] == 500
    assert counts["GLOBAL_POSITION_INT"] in (99, 100, 101)
    assert counts["EXTENDED_SYS_STATE"] in (9, 10, 11)
    assert "ATTITUDE" not in counts


def test_requested_messages_come_and_others_are_refused(station):
    request = mavlink.MAV_CMD_REQUEST_MESSAGE
    assert station.command(request, 148) == ACCEPTED
    assert station.latest("AUTOPILOT_VERSION").capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    assert station.command(request, 242) == ACCEPTED
    assert station.latest("HOME_POSITION").altitude == pytest.approx(488_060, abs=5)
    station.received.pop("AUTOPILOT_VERSION")
    assert station.command(mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1) == ACCEPTED
    assert "AUTOPILOT_VERSION" in station.received
    assert station.command(request, 12_345) == mavlink.MAV_RESULT_FAILED
    assert station.command(mavlink.MAV_CMD_DO_CHANGE_SPEED) == mavlink.MAV_RESULT_UNSUPPORTED


def test_ping_timesync_and_files(station):
    station.send(mavlink.MAVLink_ping_message(123, 7, 0, 0))
    assert (station.latest("PING").time_usec, station.latest("PING").target_system) == (123, 255)
    station.send(mavlink.MAVLink_timesync_message(0, 456))
    assert (station.latest("TIMESYNC").ts1, station.latest("TIMESYNC").tc1) == (456, int(station.vehicle.time * 1e9))
    asked = [5, 0, 2, 4, 3, *[0] * 246]
    station.send(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, asked))
    sequence, session, code, size, refused = struct.unpack_from(
        "<HBBBB", bytes(station.latest("FILE_TRANSFER_PROTOCOL").payload)
    )
    assert (sequence, session, code, size, refused) == (6, 2, 129, 1, 4)


def test_all_parameters_are_listed(station):
    station.send(mavlink.MAVLink_param_request_list_message(1, 1))
    station.wait(1.0)
    listed = station.received["PARAM_VALUE"]
    assert [value.param_index for value in listed] == list(range(len(station.vehicle.parameters)))
    assert {value.param_count for value in listed} == {len(listed)}


def test_an_estimator_that_is_not_ready_refuses_to_arm(autopilot):
    station = GroundStation(fleet_of(autopilot, ready=False, boot=8.0))
    station.wait(3.0)
    if autopilot == "ardupilot":
        station.mode(GUIDED)
    assert station.arm() not in (ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS)
    assert any("Position" in text or "position" in text for text in station.texts())
    assert station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 242) == mavlink.MAV_RESULT_FAILED
    station.wait(5.1)
    assert station.arm() == ACCEPTED


def test_without_gps_it_lands(autopilot):
    fault = VehicleFault.from_text("vehicle=0,at=14,kind=gps_loss")
    station = GroundStation(fleet_of(autopilot, faults=[fault]))
    station.take_off(3.0)
    station.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 24, 100_000)
    assert station.wait(40.0, until=lambda: not station.vehicle.armed)
    drifted = math.dist(station.fleet.bodies.qpos[0, :2], station.vehicle.local_origin[:2])
    assert 0.2 < drifted < 20
    assert station.latest("GPS_RAW_INT").fix_type == mavlink.GPS_FIX_TYPE_NO_FIX
    assert station.vehicle.phase == Phase.GROUND


def test_the_same_seed_flies_the_same(autopilot):
    noisy = CALM.replace(sigma_outer=0.2)
    ways = []
    for _ in range(2):
        station = GroundStation(fleet_of(autopilot, scenario=noisy, seed=5))
        station.take_off(3.0)
        station.wait(round(2.0 / TICK) * TICK)
        ways.append(station.vehicle.body)
    assert ways[0] == ways[1]
