"""Scenarios: the paper's defaults, TOML there and back, refusals in one line."""

from __future__ import annotations

import dataclasses
import itertools
import json
from pathlib import Path

import pytest

from moflock_mj import Scenario
from moflock_mj.errors import ScenarioError
from moflock_mj.scenario.effect_configs import ImuConfig, WindConfig
from moflock_mj.scenario.schedule import Schedule

PAPER = json.loads((Path(__file__).parents[2] / "reference" / "paper.json").read_text())["scenario"]


def test_defaults_are_the_papers():
    scenario = Scenario()
    names = {"N": "drones"}
    figures = {name: value for name, value in PAPER.items() if name not in ("r_tol",)}
    for name, value in figures.items():
        assert getattr(scenario, names.get(name, name)) == value, name
    assert scenario.r_tol == PAPER["r_tol"]


def test_the_first_fields_are_the_promised_ones():
    assert Scenario.field_names()[:4] == ("drones", "arena_side", "duration", "step")


def test_a_scenario_is_frozen_and_keyword_only():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Scenario().drones = 3
    with pytest.raises(TypeError):
        Scenario(30)


def test_toml_there_and_back():
    scenario = Scenario(
        drones=7, step=0.02, start="moflock", wind=WindConfig(speed=8.0), imu=ImuConfig(), airframe="crazyflie"
    )
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    assert Scenario.from_toml("") == Scenario()
    assert Scenario.from_toml("arena_side = 300") == Scenario(arena_side=300.0)


def test_sections_there_and_back():
    """Each section alone and all together, as TOML and as JSON; what is off reads as off."""
    sections = {name: kind() for name, kind in Scenario.sections().items()}
    alone = [Scenario(**{name: section}) for name, section in sections.items()]
    for scenario in (Scenario(), Scenario(**sections), *alone):
        assert Scenario.from_toml(scenario.to_toml()) == scenario
        assert Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))) == scenario
    assert [name for name in sections if getattr(Scenario(), name) is not None] == ["verdict"]


def test_a_section_is_of_its_own_kind():
    with pytest.raises(ScenarioError, match=r"wind: Imu.*a WindConfig, or None"):
        Scenario(wind=ImuConfig())
    with pytest.raises(ScenarioError, match=r"imu\.gyro_noise: -1\.0 is out of bounds"):
        ImuConfig(gyro_noise=-1)


def test_every_field_has_its_unit_and_meaning():
    for field in itertools.chain(*map(dataclasses.fields, [Scenario, *Scenario.sections().values()])):
        bounds = field.metadata["bounds"]
        assert bounds.unit
        assert bounds.help


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("drone = 3", "drone.*drones"),
        ("[air]\nwind = 3", "air: unknown name"),
        ("drones = 0", "drones: 0.*at least 1"),
        ("drones = 2.5", "drones: 2.5.*a whole number"),
        ("drones = true", "drones: True is of the wrong type"),
        ('drones = "30"', "drones: '30' is of the wrong type"),
        ("tau = inf", "tau: inf is not a finite number"),
        ("tau = nan", "tau: nan is not a finite number"),
        ("tau = -1", "tau: -1.0 is out of bounds"),
        ("tau = [1]", "tau: \\[1\\] is of the wrong type"),
        ('start = "here"', "start: 'here'.*one of spaced, moflock"),
        ("[wind]\nspeed = 900", r"wind\.speed: 900\.0.*at least 0 m/s and at most 60 m/s"),
        ("[wind]\nsped = 9", r"wind\.sped.*speed"),
        ("[wind]\nspeed = 'fast'", r"wind\.speed: 'fast'.*a number"),
        ("[wind]\nturbulence = 'gale'", r"wind\.turbulence: 'gale'.*one of none, light"),
        ("[wind]\nturbulence = 'light'\nw20 = 8", r"wind\.w20: 8 m/s conflicts with turbulence = light"),
        ("wind = 8", r"wind: 8.*a table, \[wind\]"),
        ("[[wind]]\nspeed = 8", r"wind: .*a table"),
        ("[battery]\ncharge = 0", r"battery\.charge: 0\.0.*over 0 and at most 1"),
        ("step = 0.03", "sample_period: 0.1 s must be a whole multiple of the step, 0.03 s"),
        ("step = 0.01\nt_gps = 0.055", "t_gps: 0.055 s must be a whole multiple of the step, 0.01 s"),
        ("duration = 0.25", "duration: 0.25 s must be a whole multiple of the sample_period, 0.1 s"),
        ("warm_up = 600", "warm_up: 600 s.*the duration, 600 s"),
        ("drones =", "not TOML"),
        ("\x00", "not TOML"),
    ],
)
def test_refusals_name_field_value_and_limit(text, words):
    with pytest.raises(ScenarioError, match=words) as refusal:
        Scenario.from_toml(text)
    assert "\n" not in str(refusal.value)


def test_a_period_is_held_against_the_step_of_the_dynamics():
    scenario = Scenario(t_gps=0.205)
    assert scenario.step_for("rigid_body") == 0.005
    with pytest.raises(ScenarioError, match=r"t_gps: 0\.205 s must be a whole multiple of the step, 0\.01 s"):
        scenario.step_for("point_mass")


def test_files_that_cannot_be_read_are_named(tmp_path):
    with pytest.raises(ScenarioError, match=r"absent\.toml: No such file"):
        Scenario.load(tmp_path / "absent.toml")
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match=r"binary\.toml: it is not UTF-8"):
        Scenario.load(binary)
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("drones = 0")
    with pytest.raises(ScenarioError, match=r"wrong\.toml: drones: 0"):
        Scenario.load(wrong)


def test_clocks_of_the_paper():
    schedule = Schedule.of(Scenario(), 0.005)
    assert schedule == Schedule(
        steps_per_interval=20,
        intervals=6000,
        sample_every=1,
        sense_every=2,
        remember_at=0,
        ticks_late=5,
        first_counted=0,
    )


def test_clocks_of_a_delay_between_ticks():
    schedule = Schedule.of(Scenario(t_gps=0.2, t_del=0.3, sample_period=0.2, duration=2.0), 0.01)
    assert (schedule.steps_per_interval, schedule.sense_every, schedule.sample_every) == (10, 2, 2)
    assert (schedule.remember_at, schedule.ticks_late) == (1, 2)
