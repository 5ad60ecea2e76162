"""The JSON schema of scenario files accepts what a scenario accepts and refuses the same mistakes."""

from __future__ import annotations

import dataclasses
import json
import tomllib
from pathlib import Path

import jsonschema
import pytest

from moflock_mj import Scenario
from moflock_mj.errors import ScenarioError
from moflock_mj.scenario.faults import KINDS
from moflock_mj.scenario.schema import scenario_schema
from moflock_mj.world.arena import SHAPES
from tests.support.cli import run

DOCS = Path(__file__).parents[3] / "docs"
SCHEMA = jsonschema.Draft202012Validator(scenario_schema())
KIND = next(name for name, kind in KINDS.items() if kind.of_all and not kind.figures)
"""A kind of fault that needs no other field than its time."""


def problems(text):
    return list(SCHEMA.iter_errors(tomllib.loads(text)))


def test_the_schema_is_one_of_draft_2020_12():
    jsonschema.Draft202012Validator.check_schema(scenario_schema())


@pytest.mark.parametrize("name", ["windy.toml", "faulty.toml"])
def test_scenarios_of_the_documentation_are_valid(name):
    assert not problems((DOCS / name).read_text())


def test_what_a_scenario_writes_is_valid():
    every_table = Scenario(**{name: kind() for name, kind in Scenario.sections().items()})
    for scenario in (Scenario(), every_table):
        assert not problems(scenario.to_toml())


def test_every_field_is_described_with_its_default():
    fields = scenario_schema()["properties"]
    assert list(fields) == list(Scenario.field_names())
    assert all(field["description"] for field in fields.values())
    assert fields["drones"]["default"] == 30
    assert fields["duration"]["description"].endswith("[s]")
    assert fields["wind"]["properties"]["turbulence"]["enum"] == ["none", "light", "moderate", "severe"]


@pytest.mark.parametrize(
    "text",
    [
        "drone = 3",
        "drones = 0",
        "drones = 2.5",
        "drones = true",
        'drones = "30"',
        "tau = [1]",
        "duration = 0",
        'start = "here"',
        "wind = 8",
        "[[wind]]\nspeed = 8",
        "[wind]\nspeed = 900",
        "[wind]\nsped = 9",
        "[wind]\nturbulence = 'gale'",
        "[battery]\ncharge = 0",
        "[arena]\nside = 100",
        "[arena]\nshape = 'square'",
        "[arena]\nshape = 'star'\nside = 100",
        "[arena]\nshape = 'square'\nside = 0",
        "[arena]\nshape = 'square'\nside = 100\nradius = 3",
        "[[faults]]\nat = 1.0",
        "[[faults]]\nkind = 'rust'",
        f"[faults]\nkind = '{KIND}'",
        f"[[faults]]\nkind = '{KIND}'\nrotor = 1",
        f"[[faults]]\nkind = '{KIND}'\ndrone = -1",
    ],
)
def test_schema_and_scenario_refuse_the_same_mistakes(text):
    assert problems(text)
    with pytest.raises(ScenarioError):
        Scenario.from_toml(text)


@pytest.mark.parametrize("name", KINDS)
def test_each_kind_of_fault_needs_its_own_figures(name):
    kind = KINDS[name]
    values = {"rotor": 0, "effectiveness": 0.5, "jump": [1.0, 0.0], "share": 0.5}
    fault = {"kind": name, "at": 1.0, "drone": 0, **{figure: values.get(figure, 0.5) for figure in kind.figures}}
    assert SCHEMA.is_valid({"faults": [fault]})
    Scenario.from_dict({"faults": [fault]})
    needed = [*kind.figures, *([] if kind.of_all else ["drone"])]
    for missing in needed:
        wrong = {"faults": [{key: value for key, value in fault.items() if key != missing}]}
        assert not SCHEMA.is_valid(wrong)
        with pytest.raises(ScenarioError):
            Scenario.from_dict(wrong)


def test_each_bound_of_a_field_is_in_the_schema():
    checked = 0
    for field in dataclasses.fields(Scenario):
        spec = field.metadata["bounds"]
        for value in (spec.low, spec.high):
            if value is None:
                continue
            beyond = value - 1 if value is spec.low else value + 1
            assert not SCHEMA.is_valid({field.name: beyond}), field.name
            assert SCHEMA.is_valid({field.name: value}) == (not (spec.open_low and value == spec.low)), field.name
            checked += 1
    assert checked > 40


def test_every_shape_of_an_arena_is_an_alternative():
    shapes = [option["properties"]["shape"]["const"] for option in scenario_schema()["properties"]["arena"]["oneOf"]]
    assert shapes == list(SHAPES)


def test_the_command_prints_or_writes_the_schema(tmp_path):
    printed = run("schema")
    assert printed.returncode == 0, printed.stderr
    assert json.loads(printed.stdout) == scenario_schema()
    out = tmp_path / "editor" / "scenario.schema.json"
    done = run("schema", "--out", out)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(out)
    assert json.loads(out.read_text()) == scenario_schema()
