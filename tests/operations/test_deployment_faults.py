"""What goes wrong in flight: nobody leaves the fence, no two come too close, and the rest of the flock goes on."""

from __future__ import annotations

import asyncio
import json
import shutil

import numpy as np
import pytest
from mcap.reader import make_reader

from moflock_mj import fly, load_point
from moflock_mj.analysis.verification import resume, verify
from moflock_mj.cli.replay_output import print_logged_flight, print_recovery
from moflock_mj.deployment.member import Stage
from moflock_mj.deployment.watchdogs import Watchdogs
from moflock_mj.errors import LogError
from moflock_mj.log.reader import read_log
from moflock_mj.log.recovery import recover
from moflock_mj.log.schemas import Packet
from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulated_vehicles import ardupilot, px4
from tests.support.rehearsal import SMALL, rehearse
from tests.support.vehicles import FAILSAFES

pytestmark = pytest.mark.slow

AT = 18
"""s on the fleet's clock, when the flock has flown for some seconds."""
FENCE = SMALL.arena_side / 2 + 10
SEPARATION = 3.0


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
    deployed, truth, _ = broken("vehicle=1,kind=link_loss,share=1", autopilot)
    assert "nothing received for 3.0 s: hold" in told(deployed, 1)
    assert [stage for number, stage in enumerate(deployed.stages) if number != 1] == [Stage.DOWN] * 3
    assert deployed.error == "1 vehicles do not respond any more"
    assert deployed.figures.flocked == pytest.approx(SMALL.duration, abs=0.2)  # the others went on
    assert not truth.armed[-1].any()  # its own failsafe brought it down


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_third_of_all_packets_is_lost(autopilot):
    deployed, truth, _ = broken("vehicle=all,kind=link_loss,share=0.3", autopilot)
    assert deployed.error is None
    assert set(deployed.stages) == {Stage.DOWN}
    assert not truth.armed[-1].any()
    assert deployed.counts["lost"] > 1000


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_all_links_are_half_a_second_late(autopilot):
    """The age of a position counts half of a round trip: all fly at half their speed."""
    deployed, truth, _ = broken("vehicle=all,kind=link_delay,delay=0.5", autopilot)
    assert deployed.error is None
    assert "position is" in told(deployed, 0)
    assert set(deployed.stages) == {Stage.DOWN}
    assert not truth.armed[-1].any()


def test_a_vehicle_takes_anothers_system_id():
    """It is not heard under its own id any more; what it says in the other's name is heard by nobody."""
    deployed, truth, _ = broken("vehicle=1,kind=duplicate_id,system=1")
    assert "nothing received for" in told(deployed, 1)
    assert "system id 1 is also used by" in told(deployed, 0)
    assert deployed.stages[0] is Stage.DOWN
    assert not truth.armed[-1][[0, 2, 3]].any()


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_vehicle_loses_its_gps(autopilot):
    deployed, truth, fleet = broken("vehicle=2,kind=gps_loss", autopilot)
    assert "under its failsafe, in LAND" in told(deployed, 2)
    assert deployed.error is None
    assert not truth.armed[-1].any()
    # PX4 is back in the mode that it was told when it disarms.
    assert fleet.stations[2].vehicle.mode == (ardupilot.LAND if autopilot == "ardupilot" else px4.OFFBOARD)


def test_a_battery_is_low():
    deployed, truth, _ = broken("vehicle=3,kind=low_battery,charge=0.1")
    assert "10 % charge left: land" in told(deployed, 3)
    assert deployed.error is None
    down = truth.armed[:, 3].nonzero()[0].max()
    assert down < len(truth.armed) - 50 * 4  # long before the others
    assert not truth.armed[-1].any()


def test_a_watchdogs_action_can_be_another():
    watchdogs = Watchdogs.from_texts(["battery=0.5:hold"])
    deployed, _, fleet = broken("vehicle=3,kind=low_battery,charge=0.4", watchdogs=watchdogs)
    assert "40 % charge left: hold" in told(deployed, 3)
    assert fleet.stations[3].vehicle.mode == ardupilot.LAND  # it landed with the others


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_pilot_takes_over_and_is_never_fought(autopilot):
    modes = []

    async def watch(_, fleet):
        while True:
            modes.append((fleet.time, fleet.stations[1].vehicle.mode))
            await asyncio.sleep(0.02)

    deployed, _, fleet = broken("vehicle=1,kind=pilot", autopilot, story=watch)
    vehicle = fleet.stations[1].vehicle
    assert f"under external control, in {vehicle.mode_names[vehicle.pilot_mode]}" in told(deployed, 1)
    assert {mode for time, mode in modes if time > AT + 0.1} == {vehicle.pilot_mode}
    assert deployed.stages[1] is Stage.TAKEN
    assert [deployed.stages[number] for number in (0, 2, 3)] == [Stage.DOWN] * 3
    assert deployed.error is None


def test_nobody_hears_anybody_any_more(tmp_path):
    """As when the deployment's process is killed: the vehicles' own failsafes bring all down.

    As when the fleet's is: the deployment ends by itself, its log is whole, and what was on the disk in the middle of
    the flight can be recovered.
    """
    path, cut = tmp_path / "gone.mcap", tmp_path / "cut.mcap"

    async def cut_off(*_):
        await asyncio.sleep(AT - 5)
        shutil.copy(tmp_path / "gone.mcap.part", cut)

    deployed, truth, _ = broken("vehicle=all,kind=link_loss,share=1", log=path, story=cut_off)
    assert not truth.armed[-1].any()
    assert deployed.error
    logged = read_log(path)
    assert not logged.complete
    assert logged.samples.t[-1] > deployed.figures.flocked
    recovery = recover(cut)
    assert recovery.kept > 5
    assert read_log(recovery.log).scenario == logged.scenario


def test_the_log_is_read_like_that_of_a_simulated_flight(tmp_path, capsys):
    path = tmp_path / "deployed.mcap"
    deployed, _, _ = broken("", log=path)
    logged = read_log(path)
    assert logged.complete
    assert logged.flown == SMALL.duration
    assert logged.order_parameters == deployed.figures.order_parameters
    assert logged.flock_name == "4 vehicles over MAVLink"
    assert [event.message for event in logged.events] == [event.message for event in deployed.events]
    flown = logged.samples.position[logged.samples.t > 10][0]
    assert flown[:, 2] == pytest.approx(SMALL.altitude, abs=1.0)
    assert abs(logged.samples.desired_velocity).max() > 1.0
    assert json.loads(logged.result["latency"])["setpoints"] == deployed.figures.latency.setpoints
    print_logged_flight(logged, as_json=False)
    print_recovery(recover(path, tmp_path / "again.mcap"), as_json=False)
    shown = capsys.readouterr().out
    assert deployed.figures.latency.sentence() in shown
    assert f"kept: {logged.samples.t[-1]:g} s, " in shown
    packets = packets_of(path)
    assert {name for name, sent in packets if sent} >= {"HEARTBEAT", "SET_POSITION_TARGET_LOCAL_NED", "COMMAND_LONG"}
    assert {name for name, sent in packets if not sent} >= {"HEARTBEAT", "GLOBAL_POSITION_INT", "ATTITUDE"}
    setpoints = packets.count(("SET_POSITION_TARGET_LOCAL_NED", True))
    assert setpoints >= deployed.figures.latency.setpoints
    for act in (verify, lambda flight: resume(flight, 1.0)):
        with pytest.raises(LogError, match=r"is of vehicles over MAVLink.*of a simulated flight"):
            act(logged)


def packets_of(path):
    """Name and direction of each logged packet of MAVLink."""
    decoder = mavlink.MAVLink(None)
    with path.open("rb") as stream:
        messages = [
            Packet.FromString(message.data)
            for _, channel, message in make_reader(stream).iter_messages()
            if channel.topic == "/mavlink"
        ]
    return [(decoder.decode(bytearray(told.packet)).get_type(), told.sent) for told in messages]


def test_order_parameters_are_within_the_spread_of_simulated_flights():
    scenario = Scenario(drones=6, arena_side=240.0, duration=60.0, warm_up=12.0, altitude=5.0, t_del=0.0)
    flights = [fly(load_point("knee"), scenario=scenario, seed=seed, keep_samples=False) for seed in range(1, 9)]
    flown = np.array([flight.order_parameters for flight in flights])
    deployed, _, _ = rehearse(scenario, autopilot="px4", fleet={"spacing": 12.0})
    off = np.abs(np.array(deployed.figures.order_parameters) - flown.mean(axis=0))
    assert (off <= 3 * flown.std(axis=0) + 1e-3).all(), (deployed.figures.order_parameters, flown)
