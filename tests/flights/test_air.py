"""Whole flights with air and wear on: what holds, what is refused, and that logs and snapshots keep all of it."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from moflock_mj import Scenario, fly, load_point, read_log
from moflock_mj.analysis.verification import resume, verify
from moflock_mj.dynamics.airframe_models import load_airframe
from moflock_mj.errors import AirframeError, ScenarioError
from moflock_mj.scenario import effect_configs
from moflock_mj.simulation.simulation import Simulation
from moflock_mj.world.constants import AIR_DENSITY
from tests.support.twins import point_mass_in_wind, quaternion_matrix

POINT = load_point("model_optimum")
EXAMPLE = Scenario.load(Path(__file__).parents[2] / "docs" / "windy.toml")
EVERYTHING = EXAMPLE.replace(drones=5, arena_side=80.0, duration=12.0, t_del=0.3)
PERFECT = effect_configs.ImuConfig(
    **dict.fromkeys((field.name for field in dataclasses.fields(effect_configs.ImuConfig)), 0.0)
)
BREEZE = EXAMPLE.replace(
    wind=effect_configs.WindConfig(speed=8.0, direction=0.5),
    battery=effect_configs.BatteryConfig(capacity=1e7, resistance=0.0),
    imu=PERFECT,
)
"""A steady wind alone, for all that is seen; every section is on, so that one compiled flight serves all tests."""

PUSH = 64 * AIR_DENSITY / 200 + 0.15 * 8
"""m/s^2, of the x500's drag in 8 m/s, see test_aerodynamics."""


def held(scenario):
    """The scenario of a flock that wants to stay where it is and knows its velocity."""
    return scenario.replace(drones=4, arena_side=200.0, v_flock=1e-6, v_max=1e-6, sigma_inner=0.0)


def test_the_example_has_every_section():
    assert [name for name in Scenario.sections() if getattr(EXAMPLE, name) is None] == ["point_mass"]


@pytest.mark.slow
@pytest.mark.parametrize("dynamics", ["rigid_body", "point_mass"])
def test_a_held_flock_stays_where_it_is(dynamics):
    """The drift ends by the integral term, whether the wind was held before the start or is met unprepared."""
    simulation = Simulation(POINT, held(BREEZE.replace(duration=100.0)), dynamics, 1)
    prepared = simulation.run(100.0)
    assert np.abs(prepared.position[:, :, :2] - prepared.position[0, :, :2]).max() < 1.5
    assert np.abs(prepared.velocity[-1]).max() < 1e-3

    simulation = Simulation(POINT, held(BREEZE.replace(duration=100.0)), dynamics, 1)
    observer = (
        simulation.body.dynamics.state.observer[:, 3:5].T
        if simulation.body
        else simulation.components.dynamics.observer[2:]
    )
    observer[:] = 0  # A body leans 9 degrees into this wind, which takes 2 % off its rotors' drag.
    surprised = simulation.run(100.0)
    along = surprised.velocity[:, :, :2] @ (math.cos(0.5), math.sin(0.5))
    assert along[:30].max() > 0.5
    assert np.abs(surprised.velocity[-1]).max() < 1e-3
    assert observer == pytest.approx(np.outer((math.cos(0.5), math.sin(0.5)), 4 * [PUSH]), rel=0.025)


def test_a_flock_in_a_breeze_stays_inside_the_fence():
    scenario = EXAMPLE.replace(drones=30, arena_side=500.0, duration=60.0)
    flight = fly(POINT, scenario=scenario, seed=1)
    outside = np.abs(flight.samples.position[..., :2]).max() - scenario.arena_side / 2
    assert outside < 0
    assert flight.body.touched == 0


def test_point_masses_in_wind_agree_with_their_slow_twin():
    scenario = BREEZE.replace(
        drones=3, duration=5.0, sigma_inner=0.0, wind=effect_configs.WindConfig(speed=8.0, turbulence="severe")
    )
    simulation, step = Simulation(POINT, scenario, "point_mass", 4), 0.01
    dynamics, world = simulation.components.dynamics, simulation.memory.world
    figures = (
        dynamics.tau,
        dynamics.a_max,
        dynamics.body_drag,
        dynamics.rotor_drag,
        dynamics.observer_bandwidth,
        dynamics.wind_max,
    )
    states = [tuple(array[:2, i].copy() for array in (world.position, world.velocity)) for i in range(3)]
    observers = [(dynamics.observer[:2, i].copy(), dynamics.observer[2:, i].copy()) for i in range(3)]
    for _ in range(50):
        simulation.run(0.1)
        for i in range(3):
            for _ in range(10):
                states[i], observers[i] = point_mass_in_wind(
                    states[i],
                    observers[i],
                    simulation.memory.desired[:, i],
                    dynamics.wind.velocity[:2, i],
                    figures,
                    step,
                )
    for i in range(3):
        np.testing.assert_allclose(world.position[:2, i], states[i][0], atol=1e-9)
        np.testing.assert_allclose(dynamics.observer[:, i], np.concatenate(observers[i]), atol=1e-9)


@pytest.mark.parametrize("dynamics", ["rigid_body", "point_mass"])
def test_it_is_the_same_however_it_is_cut_and_from_any_snapshot(dynamics):
    scenario = EVERYTHING.replace(duration=4.0)
    everything = Simulation(POINT, scenario, dynamics, 5).run(4.0)
    pieces = Simulation(POINT, scenario, dynamics, 5)
    records = [pieces.run(0.7), pieces.run(0.1)]
    resumed = Simulation(POINT, scenario, dynamics, 999)
    resumed.restore(pieces.snapshot())
    records.append(resumed.run(10.0))
    for name in ("position", "velocity"):
        joined = np.concatenate([getattr(record, name) for record in records])
        np.testing.assert_array_equal(joined, getattr(everything, name))


@pytest.mark.parametrize("dynamics", ["rigid_body", "point_mass"])
def test_its_log_has_the_sections_and_is_verified_and_resumed(tmp_path, dynamics):
    path = tmp_path / "a.mcap"
    flight = fly(POINT, scenario=EVERYTHING, dynamics=dynamics, seed=3, log=path)
    logged = read_log(path)
    assert logged.scenario == EVERYTHING
    assert verify(logged).identical
    again = resume(logged, 10.0)
    np.testing.assert_array_equal(again.samples.position[-1], flight.samples.position[-1])


def test_what_drones_believe_is_near_the_truth():
    simulation = Simulation(POINT, EVERYTHING.replace(duration=60.0), "rigid_body", 2)
    simulation.run(60.0)
    dynamics = simulation.body.dynamics
    believed = dynamics.effects.imu.estimate
    for i in range(5):
        off = quaternion_matrix(believed.qpos[i, 3:]).T @ quaternion_matrix(dynamics.state.qpos[i, 3:])
        assert math.acos(min((np.trace(off) - 1) / 2, 1)) < math.radians(3)
    assert np.abs(believed.qvel[:, :3] - dynamics.state.qvel[:, :3]).max() < 0.4
    assert np.abs(believed.qpos[:, 2] - dynamics.state.qpos[:, 2]).max() < 0.3
    assert (believed.qpos[:, 2] != dynamics.state.qpos[:, 2]).all()


def test_skipping_collisions_changes_nothing():
    """As without air, in test_rigid_body: collision detection is left out only where nothing can touch."""
    crowded = EVERYTHING.replace(drones=12, arena_side=40.0, start_spacing=2.0, duration=20.0, sigma_inner=0.005)
    flocks = [Simulation(POINT, crowded, "rigid_body", 1) for _ in range(2)]
    dynamics = flocks[1].body.dynamics
    flocks[1].components = flocks[1].components._replace(
        dynamics=dynamics._replace(model=dynamics.model._replace(reach=1e6))
    )
    records = [simulation.run(20.0) for simulation in flocks]
    np.testing.assert_array_equal(records[0].position, records[1].position)
    assert (dynamics.statistics.touch_step >= 0).any()


def test_hover_takes_its_power():
    """Measured on every flight of rigid bodies, battery or not; here 61.7 W a rotor."""
    flight = fly(POINT, scenario=held(Scenario(sigma_outer=0.0, duration=20.0)))
    assert flight.body.energy == pytest.approx(4 * 4 * 61.7 * 20.0, rel=0.01)


def test_an_empty_battery_brings_it_down():
    """With a sixtieth of its capacity it lasts some ten seconds, and then falls."""
    small = dataclasses.replace(EVERYTHING.battery, capacity=300.0)
    simulation = Simulation(POINT, EVERYTHING.replace(duration=60.0, battery=small), "rigid_body", 1)
    record = simulation.run(60.0)
    battery = simulation.body.dynamics.effects.battery
    assert (battery.charge == 0).all()
    assert (battery.lift == 0).all()
    assert record.position[50, :, 2] == pytest.approx(20.0, abs=1.0)
    assert record.position[-1, :, 2].max() < 1.0


@pytest.mark.parametrize("dynamics", ["rigid_body", "point_mass"])
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"wind": effect_configs.WindConfig(speed=40.0)},
            r"wind\.speed: 40 m/s pushes the airframe x500 with 15\.8 m/s\^2.*at most 9\.81",
        ),
        (
            {"wind": effect_configs.WindConfig(), "drag": effect_configs.DragConfig(area=9.0)},
            r"v_flock: 6 m/s pushes the airframe x500 with .*at most 9\.8",
        ),
        ({"wind": effect_configs.WindConfig(), "airframe": "paper"}, "airframe: 'paper' is unknown"),
        (
            {"wind": effect_configs.WindConfig(turbulence="light"), "altitude": 500.0},
            r"altitude: 500 m .* at most 304\.8 m",
        ),
    ],
)
def test_air_that_is_too_much_is_refused_before_the_flight(dynamics, changes, words):
    with pytest.raises((ScenarioError, AirframeError), match=words) as refusal:
        Simulation(POINT, Scenario(**changes), dynamics, 1)
    assert "\n" not in str(refusal.value)


def test_a_battery_too_empty_to_hover_is_refused():
    least = 1 / load_airframe("x500").thrust_to_weight()
    with pytest.raises(ScenarioError, match=rf"battery\.charge: 0\.001 leaves .*over {least:.0%}"):
        Simulation(POINT, Scenario(battery=effect_configs.BatteryConfig(charge=0.001)), "rigid_body", 1)
