"""Rigid-body flights: physics with a known answer, contacts, and the compiled loop's short cuts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from moflock_mj import Scenario, fly, load_point
from moflock_mj.dynamics.airframe_models import airframe_names, load_airframe
from moflock_mj.dynamics.bodies import GROUND
from moflock_mj.errors import FlightError
from moflock_mj.scenario.effect_configs import DragConfig
from moflock_mj.simulation.simulation import Simulation
from moflock_mj.world.constants import AIR_DENSITY

POINT = load_point("model_optimum")
CALM = Scenario(drones=4, duration=10.0, arena_side=200.0, sigma_outer=0.0, sigma_inner=0.0)


def flock_of(scenario, seed=1):
    return Simulation(POINT, scenario, "rigid_body", seed)


def rotors_off(simulation):
    """Let every drone fall: no thrust now, and none that it could ask for."""
    dynamics = simulation.body.dynamics
    weak = dynamics.model.gains._replace(thrust_max=0.0)
    simulation.components = simulation.components._replace(
        dynamics=dynamics._replace(model=dynamics.model._replace(gains=weak), controller=weak)
    )
    dynamics.state.thrust[:] = 0


@pytest.mark.parametrize("airframe", airframe_names())
def test_the_default_flock_keeps_its_height_and_touches_nothing(airframe):
    flight = fly(POINT, scenario=Scenario(duration=30.0, airframe=airframe))
    assert flight.body.touched == 0
    assert flight.body.altitude_error_max < 0.3
    assert flight.body.tilt_max < math.radians(45)
    assert np.isfinite(flight.samples.position).all()
    assert np.abs(flight.samples.position[..., 2] - 20.0).max() <= flight.body.altitude_error_max


def test_both_dynamics_fly_the_same_flock():
    """Without noise, bodies stay near the point masses for as long as neither is chaotic."""
    scenario = CALM.replace(drones=1, start="moflock")
    flights = [fly(POINT, scenario=scenario, dynamics=dynamics) for dynamics in ("rigid_body", "point_mass")]
    apart = np.linalg.norm(flights[0].samples.position - flights[1].samples.position, axis=-1)
    travelled = np.linalg.norm(np.diff(flights[1].samples.position, axis=0), axis=-1).sum()
    assert apart.max() < 0.05 * travelled


def test_free_fall():
    simulation = flock_of(CALM.replace(duration=1.0))
    rotors_off(simulation)
    record = simulation.run(1.0)
    steps = round(1.0 / simulation.step)
    # MuJoCo's semi-implicit Euler falls g dt^2 n (n + 1) / 2 in n steps.
    fallen = 9.81 * simulation.step**2 * steps * (steps + 1) / 2
    np.testing.assert_allclose(record.position[-1, :, 2], 20.0 - fallen, rtol=1e-9)


@pytest.mark.slow
def test_terminal_speed_under_drag():
    scenario = CALM.replace(drones=1, duration=30.0, altitude=2000.0, drag=DragConfig(rotor=0.0))
    simulation = flock_of(scenario)
    rotors_off(simulation)
    record = simulation.run(30.0)
    airframe = load_airframe("x500")
    terminal = math.sqrt(2 * airframe.mass * 9.81 / (AIR_DENSITY * airframe.drag_area))
    assert -record.velocity[-1, 0, 2] == pytest.approx(terminal, rel=1e-3)


def test_the_outer_noise_gives_the_velocity_increments_of_a_point_mass():
    """Bodies without thrust, so that no controller answers: horizontal velocity is a random walk of 2 sigma t."""
    scenario = Scenario(drones=300, arena_side=1500.0, altitude=500.0, duration=4.0)
    simulation = flock_of(scenario)
    rotors_off(simulation)
    record = simulation.run(4.0)
    variance = record.velocity[-1, :, :2].var()
    assert variance == pytest.approx(2 * scenario.sigma_outer * 4.0, rel=0.15)


def test_drones_that_meet_are_marked_and_what_follows_is_physics():
    scenario = CALM.replace(drones=2, start_spacing=0.0, duration=3.0)
    simulation = flock_of(scenario)
    dynamics = simulation.body.dynamics
    dynamics.state.qpos[:, :3] = [[0, 0, 20], [3.0, 0, 20]]
    dynamics.state.qvel[:, 0] = [4.0, -4.0]
    for row in (0, 1):
        simulation.memory.world.position[:, row] = dynamics.state.qpos[row, :3]
        simulation.memory.world.velocity[:, row] = dynamics.state.qvel[row, :3]
    record = simulation.run(3.0)
    statistics = dynamics.statistics
    assert list(statistics.touch_with) == [1, 0]
    assert 0 < statistics.touch_step[0] * simulation.step < 1.0
    # They bounce, and tilted discs may slip over each other, but never through.
    assert record.nearest.min() > load_airframe("x500").radius
    assert record.velocity[5, 0, 0] < 1.0
    assert record.velocity[5, 1, 0] > -1.0


def test_a_drone_that_falls_lies_on_the_ground():
    simulation = flock_of(CALM.replace(drones=1, altitude=2.0, duration=4.0))
    rotors_off(simulation)
    record = simulation.run(4.0)
    assert simulation.body.dynamics.statistics.touch_with[0] == GROUND
    assert simulation.body.dynamics.statistics.touch_step[0] * simulation.step == pytest.approx(
        math.sqrt(2 * 2.0 / 9.81), abs=0.05
    )
    assert 0 < record.position[-1, 0, 2] < 0.2
    assert abs(record.velocity[-1, 0, 2]) < 0.05


def test_skipping_collisions_changes_nothing():
    """A crowded flock, flown as always and with collision detection in every step, moves the same bit by bit."""
    crowded = Scenario(drones=12, arena_side=40.0, start_spacing=2.0, duration=20.0)
    flocks = [flock_of(crowded), flock_of(crowded)]
    dynamics = flocks[1].body.dynamics
    flocks[1].components = flocks[1].components._replace(
        dynamics=dynamics._replace(model=dynamics.model._replace(reach=1e6))
    )
    records = [simulation.run(20.0) for simulation in flocks]
    np.testing.assert_array_equal(records[0].position, records[1].position)
    touched = [simulation.body.dynamics.statistics.touch_step for simulation in flocks]
    np.testing.assert_array_equal(touched[0], touched[1])
    assert (touched[0] >= 0).any()


def test_a_state_that_is_not_finite_ends_the_flight():
    simulation = flock_of(CALM)
    simulation.run(1.0)
    simulation.body.dynamics.state.qvel[2, 0] = np.nan
    with pytest.raises(FlightError, match="drone 2: its state is no longer finite before 2 s"):
        simulation.run(1.0)


@pytest.mark.slow
def test_thousand_drones_fly_one_second():
    scenario = Scenario(drones=1000, arena_side=3000.0, duration=1.0)
    flight = fly(POINT, scenario=scenario, keep_samples=False)
    assert flight.complete
    assert flight.body.touched == 0
