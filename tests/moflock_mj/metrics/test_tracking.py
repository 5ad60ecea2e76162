"""Figures of a flight's motion: closed forms, and the same however the records are cut."""

import numpy as np
import pytest

from moflock_mj import Scenario, fly, load_point
from moflock_mj.flight import continue_flight
from moflock_mj.metrics.samples import SampleBuffer
from moflock_mj.metrics.tracking import MotionMeter
from moflock_mj.simulation.simulation import Simulation

SCENARIO = Scenario(drones=2, arena_side=100.0, duration=10.0)


def record_of(samples):
    """Two drones side by side at (x, y): commanded 4 m/s along x, flying 3 m/s along y, 2 m too high."""
    record = SampleBuffer.empty(samples, 0, 2)
    record.position[:] = (58.0, 0.0, SCENARIO.altitude + 2)
    record.velocity[:] = (0.0, 3.0, 0.0)
    record.desired[:] = np.array([[4.0, 4.0], [0.0, 0.0]])
    record.nearest[:] = 7.0
    return record


def test_a_steady_flight_has_figures_known_by_hand():
    meter = MotionMeter(SCENARIO)
    meter.add(record_of(11))
    figures = meter.figures()
    assert figures.velocity_error_rms == pytest.approx(5.0)
    assert figures.altitude_error_rms == pytest.approx(2.0)
    assert figures.way == pytest.approx(2 * 3.0 * 1.0)
    assert figures.separation_min == 7.0
    assert figures.outside_max == pytest.approx(8.0)


def test_the_start_has_no_command_and_no_way():
    meter = MotionMeter(SCENARIO)
    meter.add(record_of(1))
    assert meter.figures()[:3] == (0.0, 0.0, 0.0)


def test_a_lone_drone_that_speeds_up_has_the_error_of_its_exponential():
    """From 1 m/s to v along a line: the error is (v - v0) exp(-t / tau)."""
    calm = Scenario(
        drones=1, arena_side=1e5, duration=20.0, step=0.001, start="moflock", sigma_inner=0.0, sigma_outer=0.0, t_del=0
    )
    flight = fly(load_point("A"), scenario=calm, dynamics="point_mass", seed=3)
    start = np.linalg.norm(flight.samples.velocity[0, 0])
    mean_square = (calm.v_flock - start) ** 2 * calm.tau / (2 * calm.duration)
    # Samples every 0.1 s from 0.1 s on: a geometric series in place of the integral, exp(-0.1) less by a half.
    sampled = mean_square * 0.2 / np.expm1(0.2)
    assert flight.motion.velocity_error_rms == pytest.approx(np.sqrt(sampled), rel=2e-3)
    assert np.isinf(flight.motion.separation_min)
    assert flight.motion.outside_max == 0


def test_records_may_be_cut_anywhere():
    scenario = SCENARIO.replace(drones=4, duration=3.0)
    whole, pieces = (
        Simulation(load_point("A"), scenario, "point_mass", 1),
        Simulation(load_point("A"), scenario, "point_mass", 1),
    )
    one, many = MotionMeter(scenario), MotionMeter(scenario)
    one.add(whole.run(3.0))
    for seconds in (0.1, 1.2, 9.0):
        many.add(pieces.run(seconds))
    np.testing.assert_allclose(many.figures(), one.figures(), rtol=1e-12)


def test_a_drone_that_comes_down_is_lost():
    scenario = SCENARIO.replace(drones=3, duration=8.0)
    simulation = Simulation(load_point("A"), scenario, "rigid_body", 1)
    simulation.body.dynamics.model.gains.mixer[:] = 0  # nobody steers any more
    simulation.body.dynamics.state.qvel[1, 3] = 3.0  # and one rolls over

    flight = continue_flight(simulation)
    assert flight.body.lost == flight.body.touched == 1
    assert fly(load_point("A"), scenario=scenario).body.lost == 0
