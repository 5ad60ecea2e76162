"""How a deployment ends: as planned, by Ctrl-C, or because its controller is not well."""

from __future__ import annotations

import asyncio
import math

import pytest

from moflock_mj.deployment.deployment import Finish
from moflock_mj.deployment.loop_health import Health
from moflock_mj.deployment.member import Stage
from moflock_mj.deployment.return_paths import distance, is_clear
from moflock_mj.simulated_vehicles import ardupilot, px4
from moflock_mj.simulated_vehicles.vehicle_faults import Schedule, VehicleFault
from tests.support.rehearsal import SMALL, rehearse
from tests.support.vehicles import FAILSAFES

pytestmark = pytest.mark.slow


def ended(autopilot="ardupilot", scenario=SMALL, **plan):
    return rehearse(scenario, autopilot=autopilot, parameters=FAILSAFES[autopilot], fleet={"spacing": 8.0}, **plan)


def modes(fleet):
    return {station.vehicle.mode for station in fleet.stations}


@pytest.mark.parametrize(("autopilot", "hold"), [("ardupilot", ardupilot.BRAKE), ("px4", px4.HOLD)])
def test_all_hold_at_the_end(autopilot, hold):
    deployed, truth, fleet = ended(autopilot, SMALL.replace(duration=5.0), finish=Finish.HOLD)
    assert deployed.error is None
    assert modes(fleet) == {hold}
    assert set(deployed.stages) == {Stage.LEFT}
    assert truth.armed[-1].all()


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_all_return_without_crossing_each_others_way(autopilot):
    deployed, truth, fleet = ended(autopilot, SMALL.replace(duration=12.0), finish=Finish.RETURN)
    assert deployed.error is None
    assert set(deployed.stages) == {Stage.DOWN}
    assert truth.nearest() > 3
    for station in fleet.stations:
        assert math.dist(station.vehicle.body.position, station.vehicle.home) < 2.5


def test_ways_home():
    def way(*numbers):
        return (numbers[0], numbers[1]), (numbers[2], numbers[3])

    assert distance(way(0, 0, 10, 0), way(5, -5, 5, 5)) == 0
    assert distance(way(0, 0, 10, 0), way(0, 3, 10, 3)) == 3
    assert distance(way(0, 0, 10, 0), way(13, 4, 13, 4)) == 5
    assert distance(way(1, 1, 1, 1), way(4, 5, 4, 5)) == 5
    assert is_clear(way(0, 0, 10, 0), [way(0, 3, 10, 3)], 2.9)
    assert not is_clear(way(0, 0, 10, 0), [way(0, 30, 10, 30), way(0, 3, 10, 3)], 3.1)


def test_ctrl_c_once_holds_and_twice_lands():
    seen = {}

    async def press(interrupts, fleet):
        await asyncio.sleep(16.0)
        assert {station.vehicle.mode for station in fleet.stations} == {ardupilot.GUIDED}
        interrupts.press()
        await asyncio.sleep(8.0)
        seen["held"] = {station.vehicle.mode for station in fleet.stations}
        seen["speed"] = max(station.vehicle.body.speed for station in fleet.stations)
        interrupts.press()
        await asyncio.sleep(100.0)

    deployed, truth, fleet = ended(story=press)
    assert seen["held"] == {ardupilot.BRAKE}
    assert seen["speed"] < 0.5
    assert deployed.interrupted
    assert modes(fleet) == {ardupilot.LAND}
    assert not truth.armed[-1].any()


def test_ctrl_c_during_the_take_off_stops_it():
    async def press(interrupts, _):
        await asyncio.sleep(3.5)
        interrupts.press()
        await asyncio.sleep(6.0)
        interrupts.press()
        await asyncio.sleep(100.0)

    deployed, truth, _ = ended("px4", story=press)
    assert deployed.interrupted
    assert deployed.figures.flocked == 0
    assert not truth.armed[-1].any()


def test_who_does_not_arm_ends_it_and_all_come_down():
    async def spoil(_, fleet):
        await asyncio.sleep(3.6)
        fleet.stations[3].vehicle.parameters.set_value("BATT_ARM_VOLT", 99.0)
        await asyncio.sleep(100.0)

    deployed, truth, _ = ended(story=spoil, interval=3.0)
    assert "vehicle 4 at 127.0.0.1:14603: does not arm: it reports PreArm: Battery 1 below" in deployed.error
    assert deployed.figures.flocked == 0
    assert truth.flying.any()
    assert not truth.armed[-1].any()


def test_nobody_is_left_alone_while_an_order_to_arm_is_on_its_way():
    """Links of 2 s each way: Ctrl-C comes when all have the order to arm, and none has armed yet."""

    async def press(interrupts, fleet):
        while not interrupts.in_flight:
            await asyncio.sleep(0.05)
        for station in fleet.stations:
            slow = VehicleFault.from_text("vehicle=0,kind=link_delay,delay=2")
            station.faults = Schedule([slow], lambda _: None, lambda _: None)
        while not any(station.vehicle.mode == ardupilot.GUIDED for station in fleet.stations):
            await asyncio.sleep(0.05)
        await asyncio.sleep(1.5)
        assert not any(station.vehicle.armed for station in fleet.stations)
        interrupts.press()
        await asyncio.sleep(0.1)
        interrupts.press()
        await asyncio.sleep(100.0)

    deployed, truth, fleet = ended(story=press, interval=0.0)
    assert set(deployed.stages) == {Stage.DOWN}
    assert modes(fleet) == {ardupilot.LAND}
    assert truth.armed.any()
    assert not truth.armed[-1].any()
    assert not truth.flying.any()


def test_a_controller_that_is_late_sends_no_heartbeats():
    """The loop is held up for half a second again and again: the vehicles' own failsafes take over."""

    async def hold_up(*_):
        await asyncio.sleep(14.0)
        loop = asyncio.get_running_loop()
        for _ in range(40):
            loop.hold_up(0.4)
            await asyncio.sleep(0.01)

    deployed, _, _ = ended(story=hold_up)
    assert any("heartbeats stop until it recovers" in event.message for event in deployed.events)


def test_health():
    health = Health(0.05)
    now = 0.0
    for late in [0.0, 0.0, 0.1, 0.2] * 20:
        now += 0.05 + late
        assert health.take(now, late)  # late now and then
    for _ in range(5):
        now += 0.3
        health.take(now, 0.25)
    assert not health.well
    assert [level for level, _ in health.new_events()] == ["error"]
    for _ in range(59):
        now += 0.05
        assert not health.take(now, 0.0)
    for _ in range(3):
        now += 0.05
        health.take(now, 0.0)
    assert health.well
    assert not Health(0.05).take(1.0, 1.5)
