"""What goes wrong in flight: nobody leaves the fence, no two come too close, and the rest of the flock goes on."""

from __future__ import annotations

import asyncio

import pytest

from moflock_mj.deploy.member import Stage
from moflock_mj.log_reader import read_log
from moflock_mj.mavlink import ardupilot, px4
from moflock_mj.scenario import Scenario
from tests.moflock_mj.deploy.rehearsal import rehearse

SMALL = Scenario(
    drones=4, arena_side=140.0, duration=20.0, altitude=5.0, t_del=0.2, v_flock=4.0, v_max=4.0, sigma_outer=0.0,
    sigma_inner=0.0,
)  # fmt: skip
AT = 18
"""s on the fleet's clock, when the flock has flown for some seconds."""
FENCE = SMALL.arena_side / 2 + 10
SEPARATION = 3.0
FAILSAFES = {
    "ardupilot": {"FS_GCS_ENABLE": 5, "LAND_SPEED": 100},
    "px4": {"NAV_DLL_ACT": 3, "COM_OBL_RC_ACT": 5, "MPC_LAND_SPEED": 1.0},
}
"""On the loss of the ground station: land; of PX4's stream: hold."""


def broken(fault, autopilot="ardupilot", **more):
    faults = [f"{fault},at={AT}"] if fault else []
    deployed, truth, fleet = rehearse(
        SMALL, autopilot=autopilot, faults=faults, parameters=FAILSAFES[autopilot], fleet={"spacing": 8.0}, **more
    )
    assert truth.farthest() < FENCE
    assert truth.nearest() > SEPARATION
    return deployed, truth, fleet


def told(deployed, drone):
    return " | ".join(event.message for event in deployed.events if event.drone == drone)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_vehicle_falls_silent(autopilot):
    deployed, truth, _ = broken("drone=1,kind=silent", autopilot)
    assert "nothing heard of it for 3.0 s: hold" in told(deployed, 1)
    assert [stage for number, stage in enumerate(deployed.stages) if number != 1] == [Stage.DOWN] * 3
    assert deployed.error == "1 vehicles are not heard any more"
    assert deployed.figures.flocked == pytest.approx(SMALL.duration, abs=0.2)  # the others went on
    assert not truth.armed[-1].any()  # its own failsafe brought it down


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_third_of_all_packets_is_lost(autopilot):
    deployed, truth, _ = broken("drone=all,kind=link_loss,value=0.3", autopilot)
    assert deployed.error is None
    assert set(deployed.stages) == {Stage.DOWN}
    assert not truth.armed[-1].any()
    assert deployed.counts["lost"] > 1000


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_all_links_are_half_a_second_late(autopilot):
    """The age of a position counts half of a round trip: all fly at half their speed."""
    deployed, truth, _ = broken("drone=all,kind=delay,value=0.5", autopilot)
    assert deployed.error is None
    assert "its position is" in told(deployed, 0)
    assert set(deployed.stages) == {Stage.DOWN}
    assert not truth.armed[-1].any()


def test_a_vehicle_takes_anothers_system_id():
    """It is not heard under its own id any more; what it says in the other's name is heard by nobody."""
    deployed, truth, _ = broken("drone=1,kind=duplicate_id,value=1")
    assert "nothing heard of it" in told(deployed, 1)
    assert "system id 1 is spoken for from elsewhere too" in told(deployed, 0)
    assert deployed.stages[0] is Stage.DOWN
    assert not truth.armed[-1][[0, 2, 3]].any()


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_vehicle_loses_its_gps(autopilot):
    deployed, truth, fleet = broken("drone=2,kind=gps_loss", autopilot)
    assert "its failsafe flies it, in LAND" in told(deployed, 2)
    assert deployed.error is None
    assert not truth.armed[-1].any()
    assert fleet.stations[2].vehicle.mode == (ardupilot.LAND if autopilot == "ardupilot" else px4.LAND)


def test_a_battery_is_low():
    deployed, truth, _ = broken("drone=3,kind=low_battery,value=0.1")
    assert "10 % of its charge left: land" in told(deployed, 3)
    assert deployed.error is None
    down = truth.armed[:, 3].nonzero()[0].max()
    assert down < len(truth.armed) - 50 * 4  # long before the others
    assert not truth.armed[-1].any()


def test_a_watchdogs_action_can_be_another():
    from moflock_mj.deploy.watchdogs import Watchdogs

    dogs = Watchdogs.from_texts(["battery=0.5:hold"])
    deployed, _, fleet = broken("drone=3,kind=low_battery,value=0.4", dogs=dogs)
    assert "40 % of its charge left: hold" in told(deployed, 3)
    assert fleet.stations[3].vehicle.mode == ardupilot.LAND  # it landed with the others


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_pilot_takes_over_and_is_never_fought(autopilot):
    modes = []

    async def watch(_, fleet):
        while True:
            modes.append((fleet.time, fleet.stations[1].vehicle.mode))
            await asyncio.sleep(0.02)

    deployed, _, fleet = broken("drone=1,kind=pilot", autopilot, story=watch)
    vehicle = fleet.stations[1].vehicle
    assert f"somebody else flies it, in {vehicle.mode_names[vehicle.pilot_mode]}" in told(deployed, 1)
    assert {mode for time, mode in modes if time > AT + 0.1} == {vehicle.pilot_mode}
    assert deployed.stages[1] is Stage.TAKEN
    assert [deployed.stages[number] for number in (0, 2, 3)] == [Stage.DOWN] * 3
    assert deployed.error is None


def test_the_whole_fleet_is_gone(tmp_path):
    """The deployment ends by itself, and its log is whole."""
    path = tmp_path / "gone.mcap"
    deployed, _, _ = broken("drone=all,kind=silent", log=path)
    assert deployed.error
    logged = read_log(path)
    assert not logged.complete
    assert logged.samples.t[-1] > deployed.figures.flocked
