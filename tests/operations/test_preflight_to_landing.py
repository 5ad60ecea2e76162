"""Thirty vehicles from their first check to their landing."""

from __future__ import annotations

import datetime
import json

import pytest

from moflock_mj import Scenario, load_point
from moflock_mj.deployment.clearance import require_permission
from moflock_mj.deployment.deployment import DeployPlan, InterruptHandler, deploy
from moflock_mj.deployment.member import Stage
from moflock_mj.errors import CheckFailedError
from moflock_mj.preflight.inspection import LivePlan, inspect
from moflock_mj.preflight.report import Report
from tests.support import simulated_time
from tests.support.ground_station import fleet_of
from tests.support.simulated_time import Wires, connections_to, flying

pytestmark = pytest.mark.slow

SCENARIO = Scenario(drones=30, arena_side=300.0, duration=60.0, altitude=10.0, t_del=0.2)
POINT = load_point("steady")


def report_of(seen):
    return Report(
        time=datetime.datetime.now(datetime.UTC), signed_off_by="Ada", version="", commit="",
        policy="vasarhelyi", point=POINT._asdict(),
        point_name="steady", scenario=json.loads(json.dumps(SCENARIO.to_dict())), seeds=(), vehicles=seen.vehicles,
        items=(*seen.items, *seen.batteries(None)), changes=seen.changes,
    )  # fmt: skip


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_thirty_vehicles_are_checked_put_right_flown_and_landed(autopilot, tmp_path):
    fleet = fleet_of(autopilot, vehicles=30, scenario=SCENARIO, spacing=12.0)
    connections = connections_to(fleet)

    async def play():
        look = LivePlan(scenario=SCENARIO, connections=connections)
        plan = DeployPlan(
            params=POINT, scenario=SCENARIO, connections=connections, interval=0.3, log=tmp_path / "a.mcap"
        )
        async with flying(fleet):
            before = report_of(await inspect(look, None))

            async def forbidden(vehicles, _):
                require_permission([before], POINT, SCENARIO, vehicles)

            with pytest.raises(CheckFailedError):
                await deploy(plan, None, InterruptHandler(), check=forbidden)
            assert not any(station.vehicle.armed for station in fleet.stations)
            after = report_of(await inspect(LivePlan(**vars(look) | {"fix": True}), None))

            async def permitted(vehicles, _):
                require_permission([after, before], POINT, SCENARIO, vehicles)

            return after, await deploy(plan, None, InterruptHandler(), check=permitted)

    with Wires().used():
        report, deployed = simulated_time.run(play())
    assert report.verdict == "pass"
    assert deployed.error is None
    assert set(deployed.stages) == {Stage.DOWN}
    assert not any(station.vehicle.armed for station in fleet.stations)
    assert deployed.figures.flocked == pytest.approx(60.0, abs=0.2)
    assert deployed.figures.separation_min > 3
    assert deployed.figures.outside_max == 0
