"""Parameters and fences: what a vehicle must be set to, and each that fails it."""

from __future__ import annotations

import pytest

from moflock_mj import Scenario
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.mavlink.fence import Circle, Polygon
from moflock_mj.preflight.required_parameters import FlightRequirements, required_parameters
from moflock_mj.preflight.results import CheckResult
from moflock_mj.preflight.vehicle_settings import VehicleSettings, settings_items

SCENARIO = Scenario(arena_side=200.0)
NEEDS = FlightRequirements(speed=6.0, acceleration=6.0, radius=173.0, top=45.0, return_altitude=26.0)
VEHICLE = RemoteVehicle(3, "here", is_local=True, send=lambda _: None, clock=lambda: 0.0)
AUTOPILOTS = ("ardupilot", "px4")


def square(half, *, allowed=True):
    return Polygon(((-half, -half), (half, -half), (half, half), (-half, half)), allowed)


def good_values(autopilot):
    return {spellings[0].name: spellings[0].value for spellings in required_parameters(autopilot, NEEDS)}


ARENA = (square(120.0),)


def graded(autopilot, changes=None, shapes=ARENA):
    values = {name: value for name, value in (good_values(autopilot) | (changes or {})).items() if value is not None}
    found = VehicleSettings(values=values, shapes=shapes, capacity=None)
    return {item.name: item for item in settings_items(VEHICLE, autopilot, NEEDS, found, SCENARIO)}


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_what_fix_sets_passes(autopilot):
    assert {item.result for item in graded(autopilot).values()} == {CheckResult.PASS}


@pytest.mark.parametrize(
    ("autopilot", "name", "value"),
    [
        ("ardupilot", "WP_SPD", 5.0),
        ("ardupilot", "WP_ACC", 2.5),
        ("ardupilot", "ATC_ANGLE_MAX", 30.0),
        ("ardupilot", "MAV_GCS_SYSID", 7.0),
        ("ardupilot", "FS_GCS_ENABLE", 0.0),
        ("ardupilot", "FS_GCS_TIMEOUT", 60.0),
        ("ardupilot", "GUID_TIMEOUT", 30.0),
        ("ardupilot", "FENCE_ALT_MAX", 30.0),
        ("ardupilot", "FENCE_RADIUS", 150.0),
        ("ardupilot", "FENCE_ACTION", 0.0),
        ("ardupilot", "FENCE_TYPE", 1.0),
        ("ardupilot", "FENCE_ENABLE", 0.0),
        ("ardupilot", "FENCE_ENABLE", None),
        ("px4", "MPC_XY_VEL_MAX", 5.0),
        ("px4", "MPC_ACC_HOR", 3.0),
        ("px4", "MPC_ACC_HOR_MAX", 5.0),
        ("px4", "MPC_JERK_AUTO", 4.0),
        ("px4", "MPC_TILTMAX_AIR", 20.0),
        ("px4", "NAV_DLL_ACT", 0.0),
        ("px4", "COM_DL_LOSS_T", 60.0),
        ("px4", "COM_OBL_RC_ACT", 0.0),
        ("px4", "COM_OF_LOSS_T", 30.0),
        ("px4", "GF_MAX_VER_DIST", 0.0),
        ("px4", "GF_MAX_HOR_DIST", 0.0),
        ("px4", "GF_ACTION", 1.0),
        ("px4", "GF_ACTION", None),
    ],
)
def test_each_parameter_has_what_fails_it(autopilot, name, value):
    items = graded(autopilot, {name: value})
    assert {name for name, item in items.items() if item.result is not CheckResult.PASS} == {name}
    assert items[name].result is CheckResult.FAILURE
    assert items[name].advice


@pytest.mark.parametrize(("autopilot", "name"), [("ardupilot", "FENCE_RADIUS"), ("px4", "GF_MAX_HOR_DIST")])
def test_a_home_that_moves_with_its_gps_does_not_undo_what_fix_has_set(autopilot, name):
    """A real PX4's home moved by a metre between two checks, and asked for a metre more of fence."""
    value = good_values(autopilot)[name]
    moved = NEEDS._replace(radius=NEEDS.radius + 9.0)
    wanted = {want.name: want for spellings in required_parameters(autopilot, moved) for want in spellings}
    assert wanted[name].holds(value)


@pytest.mark.parametrize(("autopilot", "name"), [("ardupilot", "BATT_FS_LOW_ACT"), ("px4", "COM_LOW_BAT_ACT")])
def test_a_battery_that_only_warns_is_a_warning(autopilot, name):
    assert graded(autopilot, {name: 0.0})[name].result is CheckResult.WARNING


@pytest.mark.parametrize(
    ("name", "older", "bad", "good"),
    [
        ("MAV_GCS_SYSID", "SYSID_MYGCS", 9.0, 255.0),
        ("WP_SPD", "WPNAV_SPEED", 599.0, 600.0),
        ("WP_ACC", "WPNAV_ACCEL", 599.0, 600.0),
        ("ATC_ANGLE_MAX", "ANGLE_MAX", 3699.0, 3700.0),
    ],
)
def test_older_firmware_has_other_names_and_units(name, older, bad, good):
    assert graded("ardupilot", {name: None, older: bad})[older].result is CheckResult.FAILURE
    assert graded("ardupilot", {name: None, older: good})[older].result is CheckResult.PASS
    missing = graded("ardupilot", {name: None})[name]
    assert missing.result is CheckResult.WARNING
    assert f"{name} or {older}" in missing.advice


@pytest.mark.parametrize(
    ("shapes", "result"),
    [
        ((square(100.1),), CheckResult.PASS),
        ((Circle((0.0, 0.0), 142.0, True),), CheckResult.PASS),
        ((square(120.0), Circle((0.0, 130.0), 9.0, False)), CheckResult.PASS),
        ((square(99.0),), CheckResult.FAILURE),
        ((Circle((0.0, 0.0), 141.0, True),), CheckResult.FAILURE),
        ((square(120.0), Circle((50.0, 0.0), 9.0, False)), CheckResult.FAILURE),
        ((Circle((0.0, 130.0), 9.0, False),), CheckResult.FAILURE),
        ((), CheckResult.WARNING),
        (None, CheckResult.FAILURE),
    ],
)
def test_a_fence_allows_the_whole_arena(shapes, result):
    item = graded("px4", shapes=shapes)["fence"]
    assert item.result is result
    assert bool(item.advice) == (result is not CheckResult.PASS)
