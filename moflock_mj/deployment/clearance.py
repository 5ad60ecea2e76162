"""Clearance of a deployment by a pre-flight report: passed, recent, for the same point, scenario and vehicles."""

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
"""Maximum number of reports of a folder to read, newest first."""


def candidates(path: Path | None, key: SigningKey | None) -> list[Report]:
    """Read the report of a file, or the reports in logs/, newest first.

    Args:
        path: file of a report; None for the reports in logs/.
        key: key with which they are sealed, or None.

    Raises:
        ReportError: there is no report, or none can be read.
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
    """Return the first report that allows a deployment of this point in this scenario with these vehicles.

    Raises:
        CheckFailedError: the newest report for this deployment has a failed check.
        ReportError: no report is for this deployment, or none is recent.
    """
    connected = [checked_vehicle(vehicle) for vehicle in vehicles]
    now = datetime.datetime.now(datetime.UTC)
    first: ReportError | None = None
    for report in reports:
        try:
            refuse_unless_fit(report, params=params, scenario=scenario, vehicles=connected, now=now, age_max=age_max)
        except ReportError as problem:
            first = first or problem
        else:
            return report
    raise first or ReportError("report: none")
