"""The signed-off report of a pre-flight check: a JSON file with every value, which a deployment requires.

A digest of the whole content is its seal, so that an edited report is refused. With the key of the links, the seal
proves that the report was written by a holder of the key; without a key it only guards against mistakes.
"""

from __future__ import annotations

import dataclasses
import datetime
import getpass
import hashlib
import hmac
import json
import os
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple, Self

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError, model_validator

from controllers.policies.registry import spec_of, values_of
from moflock_mj.errors import CheckFailedError, MoflockError, PointError, ReportError
from moflock_mj.files import new_file
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.parameters.points import find_policy, point_from_values
from moflock_mj.preflight.results import CheckItem, CheckResult
from moflock_mj.scenario.scenario import Scenario

AGE_MAX = 3600.0
"""Maximum age of a report, s, since batteries, wind and satellites change."""
_LARGEST_FILE = 16 << 20
"""Maximum size, bytes; 250 vehicles with 40 items each take about 2 MB."""
_CLOCKS_APART = 60.0
"""Maximum time by which a report may be ahead of this machine's clock, s: another machine can have written it."""
_PREFIX = "preflight-"


class CheckedVehicle(BaseModel):
    """A vehicle that was checked.

    Attributes:
        system: system id.
        autopilot: "ardupilot" or "px4".
        where: address.
        uid: hardware id of AUTOPILOT_VERSION, or empty.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    system: Annotated[int, Field(ge=1, le=255)]
    autopilot: str
    where: str
    uid: str = ""


class Report(BaseModel):
    """Report of a pre-flight check.

    Attributes:
        time: time at which the check ended, UTC.
        signed_off_by: person responsible for the report.
        version: version of moflock-mj.
        commit: commit of its source, or empty.
        policy: name of the policy.
        point: parameters of the policy, by name.
        point_name: name of the point.
        scenario: the whole scenario, in the form of `Scenario.to_dict`.
        seeds: seeds of the simulated flights.
        vehicles: checked vehicles, by system id; empty for a check without vehicles.
        items: all check results.
        changes: changes made on vehicles, one line each.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    time: AwareDatetime
    signed_off_by: Annotated[str, Field(min_length=1, max_length=200)]
    version: str
    commit: str
    policy: str
    point: dict[str, float]
    point_name: str
    scenario: dict[str, object]
    seeds: tuple[int, ...]
    vehicles: tuple[CheckedVehicle, ...]
    items: tuple[CheckItem, ...]
    changes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _has_a_point(self) -> Self:
        try:
            self.params()
        except PointError as problem:
            raise ValueError(f"point: {problem}") from None
        return self

    @property
    def verdict(self) -> CheckResult:
        """The worst result of all items."""
        return CheckResult.worst(item.result for item in self.items)

    def params(self) -> NamedTuple:
        """The point."""
        return point_from_values(find_policy(self.policy), self.point)


def write_report(report: Report, path: Path, key: SigningKey | None = None) -> None:
    """Write a sealed report.

    Raises:
        MoflockError: the file cannot be written.
    """
    content = report.model_dump(mode="json")
    sealed = content | {"verdict": report.verdict, "seal": _seal(content, key), "sealed_with_key": key is not None}
    with new_file(path) as place:
        place.write_text(json.dumps(sealed, indent=1) + "\n", encoding="utf-8")


def read_report(path: Path, key: SigningKey | None = None) -> Report:
    """Read a report, which is untrusted input, and check its seal.

    Args:
        path: file written by `write_report`.
        key: key with which the report must be sealed; None for a report that must be sealed without a key.

    Raises:
        ReportError: the file cannot be read, is not a report, was edited, or is sealed with another key.
    """
    try:
        content = json.loads(_text_of(path))
        if not isinstance(content, dict):
            raise ReportError(f"report {path}: it must be a JSON object")
        seal, keyed = content.pop("seal", None), content.pop("sealed_with_key", None)
        verdict = content.pop("verdict", None)
        report = Report.model_validate_json(json.dumps(content))
    except OSError as problem:
        raise ReportError(f"report {path}: {problem.strerror}") from None
    except ValidationError as problem:
        first = problem.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise ReportError(f"report {path}: {place}: {first['msg']}") from None
    except (ValueError, RecursionError) as problem:
        raise ReportError(f"report {path}: not JSON: {problem}") from None
    if keyed is not (key is not None):
        sealed = "with a key: none was given" if keyed else "without a key: it must be sealed with the links' key"
        raise ReportError(f"report {path}: it is sealed {sealed}")
    if not isinstance(seal, str) or not hmac.compare_digest(ascii(seal), ascii(_seal(content, key))):
        raise ReportError(f"report {path}: its seal is broken: it was edited, or sealed with another key")
    if verdict != report.verdict:
        raise ReportError(f"report {path}: verdict: {verdict!r} contradicts its items: it must be {report.verdict}")
    return report


def refuse_unless_fit(
    report: Report,
    *,
    params: NamedTuple,
    scenario: Scenario,
    vehicles: Sequence[CheckedVehicle],
    now: datetime.datetime,
    age_max: float = AGE_MAX,
) -> None:
    """Refuse a report that does not allow this deployment.

    Args:
        report: the report.
        params: point of the deployment.
        scenario: scenario of the deployment.
        vehicles: connected vehicles; their addresses may differ from the report's, their identities may not.
        now: current time, with its time zone.
        age_max: maximum age of the report, s.

    Raises:
        ReportError: the report is for another point, scenario or set of vehicles, or too old.
        CheckFailedError: the report is for this deployment, and a check failed.
    """
    if report.params() != params:
        if report.policy != spec_of(params).name:
            raise ReportError(f"report: of another policy: {report.policy}, not {spec_of(params).name}")
        values = values_of(params)
        name = next(name for name, value in values.items() if report.point[name] != value)
        raise ReportError(f"report: of another point: {name} is {report.point[name]:g}, not {values[name]:g}")
    _refuse_other_scenario(report, scenario)
    if not report.vehicles:
        raise ReportError("report: without vehicles: preflight must have checked them (--vehicles)")
    checked, connected = ({(v.system, v.autopilot, v.uid) for v in group} for group in (report.vehicles, vehicles))
    if checked != connected:
        ids = [", ".join(str(v[0]) for v in sorted(group)) or "none" for group in (checked, connected)]
        raise ReportError(f"report: of other vehicles: system ids {ids[0]} were checked, {ids[1]} are connected")
    age = (now - report.time).total_seconds()
    if not -_CLOCKS_APART <= age <= age_max:
        raise ReportError(f"report: {age:.0f} s old: it must be at most {age_max:g} s")
    _refuse_failed(report)


def reports_in(folder: Path) -> list[Path]:
    """The reports of a folder, newest first, by the time in their names.

    Raises:
        ReportError: the folder has none.
    """
    found = sorted(folder.glob(f"{_PREFIX}*.json"), reverse=True)
    if not found:
        raise ReportError(f"report: none in {folder}: run moflock preflight with --vehicles first")
    return found


def default_path(folder: Path, point_name: str, time: datetime.datetime) -> Path:
    """Path of a report if none is given."""
    name = "".join(letter if letter.isalnum() else "_" for letter in point_name)
    return folder / f"{_PREFIX}{time.astimezone(datetime.UTC):%Y%m%d-%H%M%S}-{name}.json"


def signer() -> str:
    """The user's name on this machine."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return "unknown"


def _text_of(path: Path) -> str:
    # Without O_NONBLOCK, opening a named pipe would block until a writer opens it.
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise ReportError(f"report {path}: it must be a regular file")
        content = file.read(_LARGEST_FILE + 1)
    if len(content) > _LARGEST_FILE:
        raise ReportError(f"report {path}: it must be at most {_LARGEST_FILE} bytes")
    return content.decode()


def _refuse_failed(report: Report) -> None:
    if not report.items:
        raise ReportError("report: nothing was checked")
    failed = [item for item in report.items if not item.result.is_good]
    if failed:
        first = failed[0]
        more = f", and {len(failed) - 1} more" if len(failed) > 1 else ""
        raise CheckFailedError(f"report: {report.verdict}: {first.about}: {first.name}{more}")


def _refuse_other_scenario(report: Report, scenario: Scenario) -> None:
    try:
        checked = Scenario.from_dict(report.scenario)
    except MoflockError as problem:
        raise ReportError(f"report: scenario: {problem}") from None
    for field in dataclasses.fields(Scenario):
        before, now = getattr(checked, field.name), getattr(scenario, field.name)
        if before != now:
            raise ReportError(f"report: of another scenario: {field.name} is {before}, not {now}")


def _seal(content: dict[str, object], key: SigningKey | None) -> str:
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":")).encode()
    return hashlib.blake2b(canonical, key=key.secret if key else b"", person=b"moflock-preflt").hexdigest()
