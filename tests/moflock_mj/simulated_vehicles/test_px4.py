"""What PX4 does in its own way."""

from __future__ import annotations

import math
import struct

import pytest

from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.simulated_vehicles.px4 import HOLD, LAND, OFFBOARD, RETURN, TAKEOFF
from moflock_mj.simulated_vehicles.vehicle import Phase
from tests.support.ground_station import GroundStation, fleet_of, velocity

ACCEPTED, REJECTED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED
NAN = float("nan")


@pytest.fixture
def station():
    return GroundStation(fleet_of("px4"))


def offboard(station, setpoint):
    station.wait(0.3, setpoint)
    assert station.mode(OFFBOARD) == ACCEPTED


def test_it_streams_by_itself(station):
    station.wait(10.0)
    rates = {kind: len(messages) / 10 for kind, messages in station.received.items()}
    assert rates["ATTITUDE"] == pytest.approx(20, abs=0.5)
    assert rates["LOCAL_POSITION_NED"] == pytest.approx(50, abs=0.5)
    assert rates["HOME_POSITION"] == pytest.approx(0.5, abs=0.2)
    beat = station.latest("HEARTBEAT")
    assert (beat.type, beat.autopilot, beat.custom_mode) == (2, 12, 4 << 16 | 3 << 24)


def is_armable(station):
    station.wait(1.0)
    return bool(station.latest("SYS_STATUS").onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)


def test_offboard_is_accepted_without_a_stream_while_disarmed_and_does_not_arm(station):
    assert station.mode(OFFBOARD) == ACCEPTED
    station.wait(3.0)
    assert station.latest("HEARTBEAT").custom_mode == OFFBOARD
    assert station.arm() == REJECTED
    assert station.texts()[-1] == "Arming denied: Resolve system health failures first"


@pytest.mark.parametrize(
    ("mode", "armable"), [(HOLD, True), (TAKEOFF, True), (LAND, False), (RETURN, False), (OFFBOARD, False)]
)
def test_whether_it_would_arm_goes_by_its_mode(station, mode, armable):
    assert station.mode(mode) == ACCEPTED
    assert is_armable(station) == armable


def test_without_the_ground_station_that_it_must_not_lose_it_does_not_arm(station):
    station.set_parameter("NAV_DLL_ACT", 3)
    station.heartbeats = False
    station.wait(12.0)
    assert station.arm() == REJECTED
    assert station.texts()[-1] == "Preflight Fail: No connection to the GCS"
    station.heartbeats = True
    assert is_armable(station)


def test_after_a_landing_it_is_back_in_offboard(station):
    station.take_off(3.0)
    station.wait(1.0, setpoint=velocity(0, 0, 0))
    assert station.mode(OFFBOARD) == ACCEPTED
    station.wait(1.0, setpoint=velocity(0, 0, 0))
    assert station.mode(LAND) == ACCEPTED
    assert station.wait(20.0, until=lambda: not station.vehicle.armed)
    assert station.vehicle.mode == OFFBOARD
    assert not is_armable(station)


def test_offboard_without_a_stream_is_refused_in_the_air(station):
    station.take_off(3.0)
    assert station.mode(OFFBOARD) == REJECTED
    assert station.vehicle.mode == HOLD


def test_takeoff_goes_to_the_parameters_altitude_and_holds(station):
    station.set_parameter("MIS_TAKEOFF_ALT", 4.0)
    station.arm()
    assert station.command(mavlink.MAV_CMD_NAV_TAKEOFF, NAN, NAN, NAN, NAN, NAN, NAN, NAN) == ACCEPTED
    assert station.vehicle.mode == TAKEOFF
    station.wait(8.0)
    assert station.vehicle.mode == HOLD
    assert station.vehicle.height() == pytest.approx(4.0, abs=0.1)


def test_takeoff_before_arming_waits_for_it(station):
    station.command(mavlink.MAV_CMD_NAV_TAKEOFF, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
    station.wait(2.0)
    assert station.vehicle.phase == Phase.GROUND
    station.arm()
    station.wait(6.0)
    assert station.vehicle.height() > 2.0


def test_it_takes_off_in_offboard(station):
    setpoint = velocity(0, 0, -1)
    offboard(station, setpoint)
    station.arm()
    station.wait(5.0, setpoint)
    assert station.vehicle.height() > 3
    assert station.vehicle.mode == OFFBOARD


@pytest.mark.parametrize(("action", "mode"), [(0, RETURN), (3, RETURN), (4, LAND), (5, HOLD)])
def test_a_stream_that_is_lost(station, action, mode):
    station.set_parameter("COM_OBL_RC_ACT", action)
    station.take_off(5.0)
    setpoint = velocity(2, 0, 0)
    offboard(station, setpoint)
    station.wait(3.0, setpoint)
    assert station.vehicle.mode == OFFBOARD
    station.wait(0.9)
    assert station.vehicle.mode == OFFBOARD
    station.wait(0.3)
    assert station.vehicle.mode == mode
    assert "Failsafe activated: Offboard control lost" in station.texts()


@pytest.mark.parametrize(("action", "mode"), [(0, HOLD), (2, RETURN), (3, LAND)])
def test_loss_of_the_ground_station(station, action, mode):
    station.set_parameter("NAV_DLL_ACT", action)
    station.wait(0.1)
    station.take_off(5.0)
    station.wait(1.0)
    station.heartbeats = False
    station.wait(9.0)
    assert station.vehicle.mode == HOLD
    station.wait(2.0)
    assert station.vehicle.mode == mode


@pytest.mark.parametrize(("action", "mode"), [(0, OFFBOARD), (1, OFFBOARD), (2, HOLD), (3, RETURN), (5, LAND)])
def test_fence(station, action, mode):
    station.set_parameter("GF_MAX_HOR_DIST", 15.0)
    station.set_parameter("GF_ACTION", action)
    station.take_off(5.0)
    setpoint = velocity(3, 0, 0)
    offboard(station, setpoint)
    station.wait(8.0, setpoint)
    assert station.vehicle.mode == mode
    assert ("Geofence violation" in station.texts()) == (action > 0)


@pytest.mark.parametrize(
    ("action", "charge", "mode"),
    [(0, 0.06, HOLD), (2, 0.14, HOLD), (2, 0.06, LAND), (3, 0.06, RETURN), (3, 0.04, LAND)],
)
def test_low_battery(station, action, charge, mode):
    station.set_parameter("COM_LOW_BAT_ACT", action)
    station.take_off(5.0)
    station.vehicle.battery.set_remaining(charge)
    station.wait(0.5)
    assert station.vehicle.mode == mode
    assert any("battery" in text for text in station.texts())


def test_a_low_battery_does_not_arm(station):
    station.vehicle.battery.set_remaining(0.1)
    assert station.arm() == REJECTED
    assert station.texts()[0] == "Arming denied: Resolve system health failures first"


def test_integers_travel_bytewise(station):
    station.send(mavlink.MAVLink_param_request_read_message(1, 1, b"COM_DL_LOSS_T", -1))
    value = station.latest("PARAM_VALUE")
    assert value.param_type == mavlink.MAV_PARAM_TYPE_INT32
    assert struct.unpack("<i", struct.pack("<f", value.param_value)) == (10,)
    minus_two = struct.unpack("<f", struct.pack("<i", -2))[0]
    assert math.isnan(minus_two)
    station.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_DL_LOSS_T", minus_two, 6))
    assert station.vehicle.parameters["COM_DL_LOSS_T"] == -2
    station.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_DL_LOSS_T", 7.0, 9))  # of another type
    assert station.vehicle.parameters["COM_DL_LOSS_T"] == -2
