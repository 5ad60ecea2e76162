"""Whether a pre-flight report allows a deployment: passed, recent, of this point, this scenario and these vehicles."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from moflock_mj.errors import ReportError
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.preflight.inspection import checked_vehicle
from moflock_mj.preflight.report import AGE_MAX, Report, read_report, refuse_unless_fit, reports_in
from moflock_mj.scenario.scenario import Scenario

_FOLDER = Path("logs")
_READ_MAX = 100
"""Reports of a folder that are looked through, the newest first."""


def candidates(path: Path | None, key: SigningKey | None) -> list[Report]:
    """The report of a file, or those of logs/, the newest first.

    Args:
        path: a report; None: those of logs/.
        key: that they are sealed with, or None.

    Raises:
        ReportError: there is none, or none can be read.
    """
    if path is not None:
        return [read_report(path, key)]
    reports, problems = [], []
    for each in reports_in(_FOLDER)[:_READ_MAX]:
        try:
            reports.append(read_report(each, key))
        except ReportError as problem:
            problems.append(problem)
    if not reports:
        raise problems[0]
    return reports


def require_permission(
    reports: Sequence[Report],
    params: NamedTuple,
    scenario: Scenario,
    vehicles: Sequence[RemoteVehicle],
    *,
    age_max: float = AGE_MAX,
) -> Report:
    """The first report that allows to deploy this point in this scenario with these vehicles.

    Raises:
        CheckFailedError: the newest one that is of them says that a check failed.
        ReportError: none is of them, or recent.
    """
    there = [checked_vehicle(vehicle) for vehicle in vehicles]
    now = datetime.datetime.now(datetime.UTC)
    first: ReportError | None = None
    for report in reports:
        try:
            refuse_unless_fit(report, params=params, scenario=scenario, vehicles=there, now=now, age_max=age_max)
        except ReportError as problem:
            first = first or problem
        else:
            return report
    raise first or ReportError("report: none")
