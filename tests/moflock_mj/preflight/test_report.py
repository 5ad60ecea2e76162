"""Reports: they come back as they were written, allow one deployment alone, and as files from anywhere harm nobody."""

from __future__ import annotations

import datetime
import json
import os

import pytest

from moflock_mj import Scenario, load_point
from moflock_mj.errors import CheckFailedError, MoflockError, ReportError
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.preflight import report as report_module
from moflock_mj.preflight.report import (
    CheckedVehicle,
    Report,
    default_path,
    read_report,
    refuse_unless_fit,
    reports_in,
    write_report,
)
from moflock_mj.preflight.results import CheckItem, CheckResult

KEY, OTHER_KEY = SigningKey(bytes(range(32))), SigningKey(bytes(32))
NOW = datetime.datetime(2026, 5, 4, 12, 0, tzinfo=datetime.UTC)
POINT = load_point("A")
VEHICLES = tuple(CheckedVehicle(system=system, autopilot="px4", where=f"127.0.0.1:{system}") for system in (1, 2))
GOOD = CheckItem(name="battery", about="vehicle 1", result=CheckResult.PASS, value=81.5, unit="%")
WHOLE = Scenario(**{name: kind() for name, kind in Scenario.sections().items()})
"""Every section is on."""


def report_of(**changes):
    return Report(
        **{
            "time": NOW,
            "signed_off_by": "somebody",
            "version": "1",
            "commit": "",
            "policy": "vasarhelyi",
            "point": POINT._asdict(),
            "point_name": "A",
            "scenario": json.loads(json.dumps(WHOLE.to_dict())),
            "seeds": (1, 2),
            "vehicles": VEHICLES,
            "items": (GOOD,),
        }
        | changes
    )


def refuse(report, **changes):
    asked = {"params": POINT, "scenario": WHOLE, "vehicles": VEHICLES, "now": NOW + datetime.timedelta(minutes=9)}
    refuse_unless_fit(report, **asked | changes)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "preflight.json"


@pytest.mark.parametrize("key", [None, KEY])
def test_a_report_comes_back_and_allows_its_deployment(path, key):
    write_report(report_of(), path, key)
    report = read_report(path, key)
    assert report == report_of()
    refuse(report)
    # As from the scenario's file, and with vehicles that come from other ports.
    moved = [vehicle.model_copy(update={"where": "elsewhere"}) for vehicle in reversed(VEHICLES)]
    refuse(report, scenario=Scenario.from_toml(WHOLE.to_toml()), vehicles=moved)


@pytest.mark.parametrize(
    ("changes", "asked", "words"),
    [
        ({"items": (GOOD, GOOD.model_copy(update={"result": CheckResult.FAILURE}))}, {}, "failure: vehicle 1: battery"),
        ({"items": (GOOD.model_copy(update={"result": CheckResult.RUNNING}),)}, {}, "running: vehicle 1: battery"),
        ({"items": ()}, {}, "nothing was checked"),
        ({"vehicles": ()}, {}, "without vehicles"),
        ({}, {"now": NOW + datetime.timedelta(hours=1.5)}, "5400 s old.*at most 3600 s"),
        ({}, {"now": NOW - datetime.timedelta(minutes=5)}, "-300 s old"),
        ({}, {"now": NOW + datetime.timedelta(minutes=9), "age_max": 60.0}, "540 s old.*at most 60 s"),
        ({}, {"params": POINT._replace(p_rep=0.5)}, "another point: p_rep is "),
        ({}, {"scenario": WHOLE.replace(arena_side=400.0)}, "another scenario: arena_side is 500.0, not 400.0"),
        ({}, {"scenario": WHOLE.replace(wind=None)}, "another scenario: wind is "),
        ({}, {"vehicles": VEHICLES[:1]}, "other vehicles: system ids 1, 2 were checked, 1 are connected"),
        ({}, {"vehicles": [v.model_copy(update={"autopilot": "ardupilot"}) for v in VEHICLES]}, "other vehicles"),
        ({}, {"vehicles": [v.model_copy(update={"uid": "abc"}) for v in VEHICLES]}, "other vehicles"),
        ({"scenario": {"drones": "x"}}, {}, "scenario: drones: 'x' is of the wrong type"),
    ],
)
def test_a_report_allows_no_other_deployment(changes, asked, words):
    with pytest.raises((ReportError, CheckFailedError), match=words):
        refuse(report_of(**changes), **asked)


def test_that_a_check_failed_is_said_of_the_deployment_that_it_is_of_alone():
    failed = report_of(items=(GOOD.model_copy(update={"result": CheckResult.FAILURE}),))
    with pytest.raises(CheckFailedError):
        refuse(failed)
    with pytest.raises(ReportError, match="another point"):
        refuse(failed, params=POINT._replace(p_rep=0.5))


def edited(text, old, new):
    assert old in text
    return text.replace(old, new)


@pytest.mark.parametrize("key", [None, KEY])
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"value": 81.5', '"value": 91.5'),
        ('"point_name": "A"', '"point_name": "B"'),
        ('"drones": 30', '"drones": 3'),
        ("12:00:00Z", "13:00:00Z"),
        ("somebody", "nobody"),
        ('"seal": "', '"seal": "0'),
        ('"seal": "', '"seal": "\\ud800'),
    ],
)
def test_an_edited_report_is_refused(path, key, old, new):
    write_report(report_of(), path, key)
    path.write_text(edited(path.read_text(), old, new))
    with pytest.raises(ReportError, match="its seal is broken"):
        read_report(path, key)


@pytest.mark.parametrize(
    ("written", "read", "words"),
    [
        (KEY, OTHER_KEY, "sealed with another key"),
        (KEY, None, "it is sealed with a key: none was given"),
        (None, KEY, "it is sealed without a key"),
    ],
)
def test_a_seal_is_that_of_its_key(path, written, read, words):
    write_report(report_of(), path, written)
    with pytest.raises(ReportError, match=words):
        read_report(path, read)


def test_somebody_who_strips_the_key_is_refused(path):
    """The seal of a whole report made anew without the key."""
    write_report(report_of(items=(GOOD.model_copy(update={"result": CheckResult.FAILURE}),)), path, KEY)
    write_report(report_of(), path, None)
    path.write_text(edited(path.read_text(), '"sealed_with_key": false', '"sealed_with_key": true'))
    with pytest.raises(ReportError, match="its seal is broken"):
        read_report(path, KEY)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff\xfe",
        b"[]",
        b"{}",
        b"null",
        b"[" * 100_000,
        b'{"a":' * 100_000,
        b'{"time": 1e400}',
        b'{"seeds": [' + b"9" * 5000 + b"]}",
    ],
)
def test_what_is_no_report_is_refused(path, content):
    path.write_bytes(content)
    with pytest.raises(ReportError, match=r"^report .*preflight\.json: "):
        read_report(path)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("point", {"r0_rep": 1.0}, "p_rep: missing"),
        ("point", POINT._asdict() | {"a_shill": float("nan")}, "finite"),
        ("point", POINT._asdict() | {"a_shill": -1.0}, "a_shill"),
        ("items", [GOOD.model_dump() | {"value": float("inf")}], "finite"),
        ("items", [GOOD.model_dump() | {"result": "splendid"}], "result"),
        ("vehicles", [VEHICLES[0].model_dump() | {"system": 256}], "system"),
        ("time", "2026-05-04T12:00:00", "timezone"),
        ("signed_off_by", "", "signed_off_by"),
        ("more", 1, "more"),
    ],
)
def test_what_a_report_cannot_hold_is_refused(path, field, value, words):
    write_report(report_of(), path)
    path.write_text(json.dumps(json.loads(path.read_text()) | {field: value}))
    with pytest.raises(ReportError, match=words):
        read_report(path)


def test_a_report_is_a_regular_file_of_a_bounded_size(path, tmp_path, monkeypatch):
    os.mkfifo(path)
    with pytest.raises(ReportError, match="a regular file"):
        read_report(path)
    with pytest.raises(ReportError, match="Is a directory"):
        read_report(tmp_path)
    with pytest.raises(ReportError, match="No such file"):
        read_report(tmp_path / "none.json")
    monkeypatch.setattr(report_module, "_LARGEST_FILE", 100)
    path.unlink()
    write_report(report_of(), path)
    with pytest.raises(ReportError, match="at most 100 bytes"):
        read_report(path)


def test_a_report_that_cannot_be_written_leaves_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(MoflockError, match="not a folder"):
        write_report(report_of(), tmp_path / "file" / "preflight.json")
    assert [place.name for place in tmp_path.iterdir()] == ["file"]


def test_the_newest_report_of_a_folder(tmp_path):
    with pytest.raises(ReportError, match=r"none in .*: run moflock preflight"):
        reports_in(tmp_path)
    later = NOW + datetime.timedelta(seconds=1)
    places = [default_path(tmp_path, name, time) for name, time in (("a/../z", NOW), ("A", later))]
    for place in places:
        assert place.parent == tmp_path
        place.write_text("{}")
    assert reports_in(tmp_path)[0] == places[1]
