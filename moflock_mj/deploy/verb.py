"""`moflock deploy`: from what was typed to a plan."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from moflock_mj.deploy.deployment import Check, DeployPlan, Finish
from moflock_mj.deploy.permission import candidates, require_permission
from moflock_mj.deploy.readiness import parse_origin
from moflock_mj.deploy.terminal import run_deployment
from moflock_mj.deploy.watchdogs import Watchdogs
from moflock_mj.errors import DeploymentError
from moflock_mj.mavlink.connections import parse_vehicles
from moflock_mj.mavlink.ground import Ground
from moflock_mj.mavlink.remote import RemoteVehicle
from moflock_mj.mavlink.signing import SigningKey, find_key
from moflock_mj.points import load_point
from moflock_mj.scenario import DEPLOYED, Scenario
from moflock_mj.terminal import log_path


def deploy_vehicles(
    point: str,
    vehicles: str,
    scenario: Scenario,
    *,
    count: int | None,
    finish: str,
    origin: str | None,
    report: Path | None,
    rehearse: bool,
    watchdogs: Sequence[str],
    interval: float,
    timeout: float,
    key_file: Path | None,
    log: str | None,
    as_json: bool,
) -> int:
    """Deploy; arguments are those of the command line. Returns the exit status.

    Raises:
        MoflockError: nobody was armed, because of this.
    """
    if rehearse and report is not None:
        raise DeploymentError("report: a rehearsal needs none; it must be --rehearse or --report")
    if scenario.faults:
        raise DeploymentError("faults: a scenario to be deployed has none; moflock fleet breaks simulated vehicles")
    key = find_key(key_file)
    plan = DeployPlan(
        params=load_point(point),
        scenario=scenario,
        connections=parse_vehicles(vehicles),
        count=count,
        finish=Finish(finish),
        origin=parse_origin(origin) if origin else None,
        dogs=Watchdogs.from_texts(watchdogs),
        rehearse=rehearse,
        interval=interval,
        timeout=timeout,
        log=log_path(log, point, DEPLOYED, 0),
        metadata={"point": point, "finish": finish, "rehearsal": json.dumps(rehearse)},
    )
    check = None if rehearse else _permission(plan, report, key)
    return run_deployment(plan, key, check, as_json=as_json)


def _permission(plan: DeployPlan, path: Path | None, key: SigningKey | None) -> Check:
    """What refuses vehicles that no report allows to deploy; what can be seen without them is refused here."""
    reports = candidates(path, key)

    async def check(vehicles: list[RemoteVehicle], _: Ground) -> None:
        scenario = plan.scenario.replace(drones=len(vehicles))
        require_permission(reports, plan.params, scenario, vehicles)

    return check
