"""What ArduCopter does in its own way."""

from __future__ import annotations

import pytest

from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.simulated_vehicles.ardupilot import BRAKE, GUIDED, LAND, LOITER, RTL, STABILIZE
from moflock_mj.simulated_vehicles.vehicle import Phase
from tests.support.ground_station import GroundStation, fleet_of, velocity

ACCEPTED, FAILED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_FAILED


@pytest.fixture
def station():
    return GroundStation(fleet_of("ardupilot"))


def test_it_sends_heartbeats_and_little_else_until_it_is_asked(station):
    station.wait(5.0)
    assert set(station.received) == {"HEARTBEAT"}
    beat = station.latest("HEARTBEAT")
    assert (beat.type, beat.autopilot, beat.custom_mode, beat.get_srcComponent()) == (2, 3, STABILIZE, 1)
    station.send(mavlink.MAVLink_request_data_stream_message(1, 1, 0, 4, 1))
    station.wait(5.0)
    assert len(station.received["SYS_STATUS"]) in range(19, 22)
    station.send(mavlink.MAVLink_request_data_stream_message(1, 1, 0, 4, 0))
    station.received.clear()
    station.wait(2.0)
    assert set(station.received) == {"HEARTBEAT"}


def test_its_prearm_check_is_healthy_before_its_position_can_be_used():
    station = GroundStation(fleet_of("ardupilot", ready=False, boot=8.0))
    station.wait(3.0)
    station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 1)
    station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 193)
    assert station.latest("SYS_STATUS").onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK
    assert station.latest("EKF_STATUS_REPORT").flags == 0xA7
    station.mode(GUIDED)
    assert station.arm() == FAILED
    assert station.texts() == ["Arm: Need Position Estimate"]
    station.wait(5.1)
    station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 193)
    assert station.latest("EKF_STATUS_REPORT").flags == 0x33F
    assert station.arm() == ACCEPTED


def test_modes_in_which_it_cannot_be_armed(station):
    for mode in (RTL, LAND, BRAKE):
        assert station.mode(mode) == ACCEPTED
        assert station.arm() == FAILED
    assert station.texts()[0] == "Arm: RTL mode not armable"


def test_it_takes_off_only_armed_and_in_guided(station):
    takeoff = (mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0)
    station.mode(GUIDED)
    assert station.command(*takeoff) == FAILED
    station.mode(LOITER)
    assert station.arm() == ACCEPTED
    assert station.command(*takeoff) == FAILED
    station.mode(GUIDED)
    assert station.command(*takeoff[:-1], float("nan")) == FAILED
    assert station.command(*takeoff) == ACCEPTED


def test_a_velocity_lifts_nothing_off_the_ground(station):
    station.mode(GUIDED)
    station.arm()
    station.wait(3.0, velocity(1, 0, -2))
    assert station.vehicle.phase == Phase.GROUND


def test_a_velocity_during_the_takeoff_cancels_it(station):
    station.mode(GUIDED)
    station.arm()
    station.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 10.0)
    station.wait(2.5)
    height = station.vehicle.height()
    assert 1 < height < 5
    station.wait(10.0, velocity(0.5, 0, 0))
    assert station.vehicle.height() < height + 2


def test_without_setpoints_for_3_s_it_stops_and_hovers_and_never_lands(station):
    station.take_off(5.0)
    station.wait(3.0, velocity(3, 0, 0))
    station.wait(2.9)
    assert station.vehicle.body.speed > 2.5
    station.wait(8.0)
    assert station.vehicle.body.speed < 0.3
    station.wait(60.0)
    assert station.vehicle.height() == pytest.approx(5.0, abs=0.2)
    assert station.vehicle.mode == GUIDED


@pytest.mark.parametrize(("action", "mode"), [(0, GUIDED), (1, RTL), (5, LAND)])
def test_loss_of_the_ground_station(station, action, mode):
    station.set_parameter("FS_GCS_ENABLE", action)
    station.take_off(5.0)
    station.wait(2.0)
    station.heartbeats = False
    station.wait(4.0)
    assert station.vehicle.mode == GUIDED
    station.wait(3.0, velocity(0, 0, 0))  # setpoints are no heartbeats
    assert station.vehicle.mode == mode
    assert ("GCS Failsafe" in station.texts()) == (action > 0)
    assert (station.latest("HEARTBEAT").system_status == mavlink.MAV_STATE_CRITICAL) == (action > 0)


def test_another_systems_heartbeats_are_not_the_ground_stations(station):
    station.set_parameter("FS_GCS_ENABLE", 1)
    station.set_parameter("SYSID_MYGCS", 254)
    station.take_off(5.0)
    station.wait(20.0)
    assert station.vehicle.mode == GUIDED  # never heard, never lost


@pytest.mark.parametrize(("action", "mode"), [(0, GUIDED), (1, RTL), (2, LAND), (4, BRAKE)])
def test_fence(station, action, mode):
    for name, value in (("FENCE_ENABLE", 1), ("FENCE_RADIUS", 20.0), ("FENCE_ACTION", action)):
        station.set_parameter(name, value)
    station.take_off(5.0)
    station.wait(9.0, velocity(3, 0, 0))
    assert station.vehicle.mode == mode
    assert "Fence Breached" in station.texts()


def test_the_fence_is_off_until_it_is_enabled(station):
    station.set_parameter("FENCE_RADIUS", 20.0)
    station.take_off(5.0)
    station.wait(9.0, velocity(3, 0, 0))
    assert station.vehicle.mode == GUIDED
    station.command(mavlink.MAV_CMD_DO_FENCE_ENABLE, 1)
    station.wait(0.5)
    assert station.vehicle.mode == RTL


@pytest.mark.parametrize(("action", "mode"), [(0, GUIDED), (1, LAND), (2, RTL)])
def test_low_battery(station, action, mode):
    station.set_parameter("BATT_FS_LOW_ACT", action)
    station.take_off(5.0)
    station.vehicle.battery.set_remaining(0.15)
    station.wait(9.0)
    assert station.vehicle.mode == GUIDED
    station.wait(2.0)
    assert station.vehicle.mode == mode
    assert any(text.startswith("Battery 1 is low") for text in station.texts())


def test_integers_travel_as_the_floats_value(station):
    station.send(mavlink.MAVLink_param_request_read_message(1, 1, b"RTL_ALT", -1))
    value = station.latest("PARAM_VALUE")
    assert (value.param_value, value.param_type) == (1500.0, mavlink.MAV_PARAM_TYPE_INT32)
    station.send(mavlink.MAVLink_param_set_message(1, 1, b"FENCE_ACTION", 300.0, 9))
    assert station.vehicle.parameters["FENCE_ACTION"] == 127
    station.send(mavlink.MAVLink_param_set_message(1, 1, b"FENCE_RADIUS", float("nan"), 9))
    assert station.latest("PARAM_VALUE").param_value == 300.0


def test_an_unknown_mode_and_a_mode_without_a_position_are_refused(station):
    assert station.mode(77) == FAILED
    station.take_off(3.0)
    station.vehicle.estimator = type(station.vehicle.estimator)(boot=1e9)
    assert station.mode(LOITER) == FAILED
    assert "Mode change to LOITER failed: requires position" in station.texts()


def test_it_says_why_it_does_not_arm_when_it_is_asked_and_by_itself(station):
    station.set_parameter("BATT_ARM_VOLT", 13.0)
    reason = "PreArm: Battery 1 below minimum arming voltage"
    assert station.command(mavlink.MAV_CMD_RUN_PREARM_CHECKS) == ACCEPTED
    assert station.texts() == [reason]
    station.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 1)
    assert not station.latest("SYS_STATUS").onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK
    station.wait(31.0)
    assert station.texts() == [reason, reason]
    assert station.arm() == FAILED
