"""`moflock deploy`: what it refuses, in one line and with nobody armed, and one rehearsal on real sockets."""

from __future__ import annotations

import asyncio
import datetime
import json
import subprocess

import pytest

from moflock_mj import load_point
from moflock_mj.deployment.clearance import candidates, require_permission
from moflock_mj.deployment.prelaunch import require_simulated
from moflock_mj.deployment.watchdogs import Action, Watchdog, Watchdogs
from moflock_mj.errors import CheckFailedError, DeploymentError, LinkError, MoflockError, ReportError
from moflock_mj.ground_station.origin import parse_origin
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.preflight.inspection import checked_vehicle
from moflock_mj.preflight.report import Report, write_report
from moflock_mj.preflight.results import CheckItem, CheckResult
from moflock_mj.simulated_vehicles.fleet import Fleet, FleetPlan
from tests.support.cli import MOFLOCK, refused
from tests.support.rehearsal import SCENARIO, rehearse

NOW = datetime.datetime.now(datetime.UTC)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--vehicles", ""), "vehicles: '' is invalid"),
        (("--vehicles", "udp:127.0.0.1:14999"), "report: none in logs"),
        (("--vehicles", "udp:127.0.0.1:14999", "--report", "absent.json"), "report absent.json: No such file"),
        (("--vehicles", "udp:127.0.0.1:14999", "--rehearse", "--timeout", 0.2), "from 1 of 1 links within 0.2 s"),
    ],
)
def test_bad_use_is_one_line_and_status_2(tmp_path, arguments, words):
    assert words in refused("deploy", "knee", *arguments, cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []


def vehicle(system=1, uid=7):
    heard = RemoteVehicle(system, "127.0.0.1:1", is_local=True, send=lambda _: None, clock=lambda: 0.0)
    heard.note(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3))
    heard.note(mavlink.MAVLink_autopilot_version_message(0, 0, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, uid))
    return heard


def report(**changes):
    facts = {
        "time": NOW, "signed_off_by": "somebody", "version": "0", "commit": "", "point_name": "knee", "seeds": (1,),
        "policy": "vasarhelyi", "point": load_point("knee")._asdict(),
        "scenario": json.loads(json.dumps(SCENARIO.replace(drones=1).to_dict())),
        "vehicles": (checked_vehicle(vehicle()),),
        "items": (CheckItem(name="all", about="point", result=CheckResult.PASS),),
    }  # fmt: skip
    return Report(**{**facts, **changes})


def permit(*reports, there=None, scenario=SCENARIO):
    return require_permission(reports, load_point("knee"), scenario.replace(drones=1), there or [vehicle()])


def test_a_report_that_fits_is_found_behind_others():
    good = report()
    old = report(time=NOW - datetime.timedelta(hours=2))
    assert permit(old, good) is good


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"time": NOW - datetime.timedelta(hours=2)}, "s old.* 3600 s"),
        ({"point": load_point("B")._asdict()}, "of another point: r0_rep"),
        ({"scenario": json.loads(json.dumps(SCENARIO.replace(drones=1, duration=31.0).to_dict()))}, "duration is 31.0"),
        ({"vehicles": ()}, "without vehicles"),
        ({"vehicles": (checked_vehicle(vehicle(uid=8)),)}, "of other vehicles"),
    ],
)
def test_a_report_of_something_else_is_refused(changes, words):
    with pytest.raises(ReportError, match=words):
        permit(report(**changes))


def test_a_report_that_failed_is_a_failed_check():
    bad = report(items=(CheckItem(name="battery", about="vehicle 1", result=CheckResult.FAILURE),))
    with pytest.raises(CheckFailedError, match="failure: vehicle 1: battery"):
        permit(bad, report())


def test_reports_are_looked_for_in_logs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ReportError, match="none in logs"):
        candidates(None, None)
    for number in (1, 2):
        write_report(report(seeds=(number,)), tmp_path / "logs" / f"preflight-2026-{number}.json")
    (tmp_path / "logs" / "preflight-2026-3.json").write_text("{")
    assert [found.seeds for found in candidates(None, None)] == [(2,), (1,)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("battery", "NAME=LIMIT:ACTION"),
        ("bird=1", "with NAME one of stale, lost, fence, separation, battery, keep_off"),
        ("battery=0.3:explode", "'explode'.* slow, hold, return, land"),
        ("lost=1e9", "1000000000|1e.?0?9"),
        ("keep_off=3:land", "keep_off has a limit and no action"),
    ],
)
def test_a_bad_watchdog(text, words):
    with pytest.raises(DeploymentError, match=words):
        Watchdogs.from_texts([text])


def test_watchdogs_are_changed_by_texts():
    watchdogs = Watchdogs.from_texts(["battery=0.3:return", "stale=hold", "fence=7", "keep_off=12"])
    assert watchdogs.battery == Watchdog(0.3, Action.RETURN)
    assert watchdogs.stale == Watchdog(0.5, Action.HOLD)
    assert watchdogs.fence == Watchdog(7.0, Action.HOLD)
    assert watchdogs.keep_off == 12.0


def test_origins():
    assert parse_origin("47.5, -8.25") == (47.5, -8.25)
    for text in ("47.5", "north,east", "91,0", "nan,0"):
        with pytest.raises(DeploymentError, match="origin"):
            parse_origin(text)


@pytest.mark.parametrize(
    ("more", "error", "words"),
    [
        ({"autopilot_wanted": "px4"}, DeploymentError, "autopilot is ardupilot; it must be px4"),
        ({"origin": (48.0, 8.5)}, DeploymentError, "stands outside the 200 m arena"),
        ({"fleet": {"spacing": 2.0}}, DeploymentError, r"stand 2.0 m apart; it must be at least 3 m"),
        (
            {"faults": ["vehicle=1,kind=low_battery,charge=0.1"]},
            DeploymentError,
            "battery at 10 %.* 20 %",
        ),
        ({"faults": ["vehicle=1,kind=link_loss,share=1"]}, LinkError, "from 1 of 5 links"),
        ({"faults": ["vehicle=1,kind=duplicate_id,system=1"]}, LinkError, "system id 1 is used by"),
        ({"fleet": {"boot": 60.0, "ready": False}}, DeploymentError, "has no position yet; wait for its GPS"),
    ],
)
def test_what_must_not_take_off_is_refused(more, error, words):
    armed = []

    async def watch(_, fleet):
        while True:
            armed.append(any(station.vehicle.armed for station in fleet.stations))
            await asyncio.sleep(0.02)

    wanted = more.pop("autopilot_wanted", None)
    with pytest.raises(error, match=words):
        rehearse(SCENARIO, story=watch, wanted=wanted, timeout=3.0, **more)
    assert armed
    assert not any(armed)


def test_a_rehearsal_with_who_may_be_real_is_refused(monkeypatch):
    monkeypatch.setattr("moflock_mj.simulated_vehicles.telemetry.SIMULATED", (0,) * 8)
    with pytest.raises(MoflockError, match="does not identify as simulated: it needs a pre-flight report"):
        rehearse(SCENARIO.replace(drones=1))


def test_px4s_own_simulation_says_what_it_is():
    """Its identity is SIMULATIONID0000, of which AUTOPILOT_VERSION has eight letters, one more for each system id."""
    first = 5283920058631409231
    asyncio.run(require_simulated([vehicle(1, first), vehicle(3, first + 2)]))
    with pytest.raises(MoflockError, match="does not identify as simulated"):
        asyncio.run(require_simulated([vehicle(3, first)]))


@pytest.mark.slow
def test_a_rehearsal_on_sockets(tmp_path):
    """Two vehicles, three seconds, the real clock: the whole command, its JSON, its log."""

    async def play():
        fleet = Fleet(FleetPlan(autopilot="px4", base_port=0, vehicles=2, boot=0.0, spacing=8.0))
        await fleet.open()
        flight = asyncio.create_task(fleet.run())
        where = ",".join(f"udp:127.0.0.1:{station.address[1]}" for station in fleet.stations)
        (tmp_path / "low.toml").write_text("altitude = 2.0\narena_side = 100.0\n")
        try:
            deployment = await asyncio.create_subprocess_exec(
                MOFLOCK, "deploy", "knee", "--vehicles", where, "--rehearse", "--scenario", "low.toml",
                "--duration", "3", "--interval", "0.2", "--timeout", "60", "--json", "--log", "a.mcap",
                cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )  # fmt: skip
            out, err = await deployment.communicate()
        finally:
            flight.cancel()
            fleet.close()
        return deployment.returncode, json.loads(out), err.decode()

    status, summary, err = asyncio.run(play())
    assert (status, err) == (0, "")
    assert summary["complete"]
    assert summary["stages"] == ["down", "down"]
    assert summary["latency"]["setpoints"] > 60
    assert (tmp_path / "a.mcap").exists()
