"""Vehicles of our fleet on their links: they pass once they are put right, and what is wrong shows in its row."""

from __future__ import annotations

import asyncio
import copy

import pytest

from moflock_mj import Scenario
from moflock_mj.errors import CommandError, LinkError
from moflock_mj.mavlink.parameters import REAL32, Parameter
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.preflight.inspection import LivePlan, inspect
from moflock_mj.preflight.results import CheckResult
from moflock_mj.simulated_vehicles.parameter_table import ParameterTable
from moflock_mj.simulated_vehicles.px4 import HOLD, OFFBOARD
from moflock_mj.simulated_vehicles.vehicle_faults import VehicleFault
from tests.support import simulated_time
from tests.support.ground_station import fleet_of
from tests.support.simulated_time import Wires, connections_to, flying

SCENARIO = Scenario(arena_side=200.0, t_del=0.2)
AUTOPILOTS = ("ardupilot", "px4")
KEY = SigningKey(bytes(range(32)))
GPS_LOST = "vehicle=1,kind=gps_loss"


def look(fleet, *, key=None, first=None, **plan):
    """Inspect a fleet in simulated time."""

    async def play():
        async with flying(fleet):
            if first:
                await first()
            return await inspect(LivePlan(**{"scenario": SCENARIO, "connections": connections_to(fleet)} | plan), key)

    with Wires().used():
        return simulated_time.run(play())


def wrong(seen):
    """What did not pass: grades by whom it is about, and name."""
    items = (*seen.items, *seen.batteries(None))
    assert all(item.advice for item in items if not item.result.is_good)
    return {(item.about, item.name): item.result for item in items if item.result is not CheckResult.PASS}


def parameters_of(fleet):
    tables = [station.vehicle.parameters for station in fleet.stations]
    return [{name: table[name] for name in map(table.name, range(len(table)))} for table in tables]


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_nothing_changes_until_it_is_asked_for_and_then_all_is_well(autopilot):
    fleet = fleet_of(autopilot, vehicles=2)
    before = copy.deepcopy(parameters_of(fleet))
    seen = look(fleet)
    assert set(wrong(seen).values()) == {CheckResult.FAILURE, CheckResult.WARNING}
    assert seen.changes == ()
    assert parameters_of(fleet) == before
    assert not any(station.vehicle.shapes for station in fleet.stations)

    fixed = look(fleet, fix=True)
    assert wrong(fixed) == {}
    changed = [
        f"vehicle {number}: {name}: {old:g} -> {new[name]:g}"
        for number, (values, new) in enumerate(zip(before, parameters_of(fleet), strict=True), 1)
        for name, old in values.items()
        if new[name] != old
    ]
    told = [line for line in fixed.changes if ": fence:" not in line]
    assert sorted(told) == sorted(changed)
    assert sum(": fence:" in line for line in fixed.changes) == 2
    assert [(vehicle.system, vehicle.autopilot) for vehicle in fixed.vehicles] == [(1, autopilot), (2, autopilot)]

    again = look(fleet, fix=True)
    assert (wrong(again), again.changes) == ({}, ())
    assert not any(station.vehicle.armed for station in fleet.stations)


RENAMED = {
    "SYSID_MYGCS": ("MAV_GCS_SYSID", 1.0),
    "WPNAV_SPEED": ("WP_SPD", 0.01),
    "WPNAV_ACCEL": ("WP_ACC", 0.01),
    "ANGLE_MAX": ("ATC_ANGLE_MAX", 0.01),
    "RTL_ALT": ("RTL_ALT_M", 0.01),
}
"""ArduCopter 4.6's names, and what 4.7 makes of them and of their values."""


def test_arducopter_4_7_has_other_names_and_units():
    fleet = fleet_of("ardupilot", vehicles=2)
    for station in fleet.stations:
        table = station.vehicle.parameters
        defaults = {name: Parameter(REAL32, table[name]) for name in map(table.name, range(len(table)))}
        for old, (name, unit) in RENAMED.items():
            defaults[name] = Parameter(REAL32, defaults.pop(old).value * unit)
        station.vehicle.parameters = ParameterTable(defaults, bytewise=False)
    assert {"WP_ACC", "ATC_ANGLE_MAX"} <= {name for _, name in wrong(look(fleet))}
    fixed = look(fleet, fix=True)
    assert wrong(fixed) == {}
    kept = [{name: table[name] for name, _ in RENAMED.values()} for table in parameters_of(fleet)]
    assert kept == [
        {"MAV_GCS_SYSID": 255, "WP_SPD": 10, "WP_ACC": 6, "ATC_ANGLE_MAX": 37, "RTL_ALT_M": height}
        for height in (kept[0]["RTL_ALT_M"], kept[0]["RTL_ALT_M"] + 3)
    ]


def test_a_px4_that_is_in_offboard_after_a_flight_is_let_hold():
    fleet = fleet_of("px4")
    vehicle = fleet.stations[0].vehicle
    vehicle.request_mode(OFFBOARD)
    seen = look(fleet, wait=1.0)
    assert wrong(seen)[("vehicle 1", "arming checks")] is CheckResult.FAILURE
    assert vehicle.mode == OFFBOARD
    fixed = look(fleet, fix=True)
    assert wrong(fixed) == {}
    assert "vehicle 1: mode: OFFBOARD -> HOLD" in fixed.changes
    assert vehicle.mode == HOLD


@pytest.mark.parametrize("unknown", [-1.0, 0.0])
def test_a_battery_that_nobody_has_described_must_have_half(unknown):
    """PX4's BAT1_CAPACITY is -1 until somebody sets it."""
    fleet = fleet_of("px4", faults=[VehicleFault.from_text("vehicle=0,kind=low_battery,charge=0.45")])
    fleet.stations[0].vehicle.parameters.set_value("BAT1_CAPACITY", unknown)
    (battery,) = look(fleet).batteries(60_000.0)
    assert battery.result is CheckResult.FAILURE
    assert "half, of an unknown capacity" in battery.limit


@pytest.fixture(scope="module")
def ready():
    """A function that makes a fleet that passes, but for the faults that befall it."""

    def make(autopilot="px4", **plan):
        fleet = fleet_of(autopilot, **{"vehicles": 2, **plan})
        if "values" not in cache:
            template = fleet_of(autopilot, vehicles=2)
            look(template, fix=True)
            cache["values"] = parameters_of(template)
            cache["fences"] = [list(station.vehicle.fence.items) for station in template.stations]
        for station, values, fence in zip(fleet.stations, cache["values"], cache["fences"], strict=True):
            for name, value in values.items():
                station.vehicle.parameters.set_value(name, value)
            station.vehicle.fence._store(fence)
        return fleet

    cache = {}
    return make


@pytest.mark.parametrize(
    ("fault", "rows"),
    [
        ("vehicle=1,kind=low_battery,charge=0.1", {("vehicle 2", "battery")}),
        ("vehicle=1,kind=link_delay,delay=0.3", {("vehicle 2", "link's round trip")}),
        ("vehicle=1,kind=link_loss,share=0.3", {("vehicle 2", "link's loss")}),
        (GPS_LOST, {("vehicle 2", name) for name in ("GPS fix", "GPS satellites", "sensors", "arming checks")}),
        ("vehicle=1,kind=link_loss,share=1,at=7", {("vehicle 2", "link alive")}),
    ],
)
def test_a_fault_shows_in_its_row(ready, fault, rows):
    fleet = ready(faults=[VehicleFault.from_text(fault)])
    seen = look(fleet, wait=8.0)
    found = wrong(seen)
    assert rows <= {row for row, result in found.items() if result is CheckResult.FAILURE}
    assert {about for about, _ in found} <= {"vehicle 2", "flock"}


def test_vehicles_that_stand_too_close(ready):
    assert wrong(look(ready(spacing=2.0)))[("flock", "spacing on the ground")] is CheckResult.FAILURE


def test_an_arena_that_is_elsewhere(ready):
    found = wrong(look(ready(), origin=(47.41, 8.545594)))
    assert found[("flock", "all in the arena")] is CheckResult.FAILURE
    assert found[("vehicle 1", "home in the arena")] is CheckResult.FAILURE
    assert found[("vehicle 1", "fence")] is CheckResult.FAILURE


def test_one_return_altitude_for_all(ready):
    fleet = ready()
    for station in fleet.stations:
        station.vehicle.parameters.set_value("RTL_RETURN_ALT", 30.0)
    assert wrong(look(fleet)) == {("flock", "return altitudes staggered"): CheckResult.FAILURE}


def test_a_clock_of_its_own(ready):
    fleet = ready()
    fleet.stations[1].telemetry._unix_start -= 100.0
    assert wrong(look(fleet)) == {("flock", "one clock"): CheckResult.WARNING}


def test_estimators_are_waited_for(ready):
    fleet = ready(ready=False, boot=20.0)
    assert wrong(look(fleet, wait=60.0)) == {}
    assert 20.0 < fleet.time < 45.0


def test_the_wait_has_an_end(ready):
    fleet = ready(ready=False, boot=60.0)
    found = wrong(look(fleet, wait=10.0))
    assert found[("vehicle 1", "home")] is CheckResult.FAILURE
    assert fleet.time < 45.0


def test_nothing_is_put_right_on_a_vehicle_that_is_armed(ready):
    fleet = ready()
    fleet.stations[0].vehicle.parameters.set_value("NAV_DLL_ACT", 0)

    async def arm():
        await asyncio.sleep(5.0)
        fleet.stations[1].vehicle.arm(force=True)

    with pytest.raises(CommandError, match=r"vehicle 2 .* is armed or in the air: nothing was changed"):
        look(fleet, fix=True, first=arm, wait=1.0)
    assert fleet.stations[0].vehicle.parameters["NAV_DLL_ACT"] == 0


@pytest.mark.parametrize(
    ("plan", "asked", "words"),
    [
        (
            {"faults": [VehicleFault.from_text("vehicle=1,kind=link_loss,share=1")]},
            {},
            "from 1 of 2 links within 2 s: udpout:127.0.0.1:",
        ),
        ({"faults": [VehicleFault.from_text("vehicle=1,kind=duplicate_id,system=1")]}, {}, "system id 1 is used by"),
        ({}, {"autopilot": "ardupilot"}, "autopilot is px4; it must be ardupilot"),
        ({}, {"count": 3}, r"2 connected \(system ids 1, 2\); it must be 3"),
        ({}, {"key": KEY}, "packets were unsigned or wrongly signed"),
    ],
)
def test_what_is_not_the_flock_that_was_asked_for(ready, plan, asked, words):
    fleet = ready(**plan)
    before = parameters_of(fleet)
    with pytest.raises(LinkError, match=words):
        look(fleet, fix=True, timeout=2.0, **asked)
    assert parameters_of(fleet) == before
