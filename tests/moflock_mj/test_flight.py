"""Whole flights: against the slow twin, the same however they are cut, resumed, stopped."""

from __future__ import annotations

import numpy as np
import pytest

from moflock_mj import MoflockError, Scenario, fly, load_point
from moflock_mj.errors import LogError, PointError, ScenarioError
from moflock_mj.scenario.effect_configs import PointMassConfig, WindConfig
from moflock_mj.simulation.simulation import Simulation
from tests.support import twins

A = load_point("A")
SHORT = Scenario(drones=6, arena_side=120.0, duration=12.0)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"step": 0.1},
        {"t_del": 0.3},
        {"t_del": 0.0},
        {"t_gps": 0.3, "sample_period": 0.2, "t_del": 0.5, "duration": 12.0},
        {"start": "moflock", "r_comm": 40.0},
        {"step": 0.1, "point_mass": PointMassConfig(tau=0.8, a_max=4.0, delay=0.13), "duration": 6.0},
        {"step": 0.05, "point_mass": PointMassConfig(delay=0.3), "start": "moflock", "duration": 6.0},
    ],
)
def test_a_point_mass_flight_is_that_of_its_slow_twin(changes):
    scenario = SHORT.replace(**changes)
    flight = fly(A, scenario=scenario, dynamics="point_mass", seed=3)
    slow = twins.SlowFlight(A, scenario, 3).fly()
    positions = np.array([x for x, _ in slow.samples])
    velocities = np.array([v for _, v in slow.samples])
    np.testing.assert_allclose(flight.samples.position, positions, rtol=0, atol=1e-7)
    np.testing.assert_allclose(flight.samples.velocity, velocities, rtol=0, atol=1e-7)
    expected = twins.order_parameters(flight.samples.position, flight.samples.velocity, A, scenario)
    np.testing.assert_allclose(flight.order_parameters, expected, rtol=1e-10, atol=1e-12)


def test_samples_have_the_promised_shapes_and_times():
    flight = fly(A, scenario=SHORT, dynamics="point_mass")
    samples = flight.samples
    assert samples.t.shape == (121,)
    assert samples.t[0] == 0
    assert samples.t[-1] == pytest.approx(12.0)
    assert samples.position.shape == samples.velocity.shape == (121, 6, 3)
    assert samples.desired_velocity.shape == (121, 6, 2)
    assert flight.complete
    assert flight.order_parameters.vel == samples.order_parameters.vel[-1]
    np.testing.assert_array_equal(samples.position[..., 2], SHORT.altitude)


@pytest.mark.parametrize(
    ("dynamics", "response"),
    [("point_mass", None), ("point_mass", PointMassConfig(delay=0.25)), ("rigid_body", None)],
)
def test_a_flight_is_the_same_however_it_is_cut_and_from_any_snapshot(dynamics, response):
    scenario = SHORT.replace(point_mass=response, duration=4.0, packet_loss_ratio=0.5, t_del=0.3)
    whole = Simulation(A, scenario, dynamics, 5)
    everything = whole.run(4.0)
    pieces = Simulation(A, scenario, dynamics, 5)
    records = [pieces.run(0.7), pieces.run(0.1)]
    resumed = Simulation(A, scenario, dynamics, 999)
    resumed.restore(pieces.snapshot())
    assert resumed.time == pytest.approx(0.8)
    records.append(resumed.run(10.0))
    for name in ("position", "velocity", "order_parameters", "status"):
        joined = np.concatenate([getattr(record, name) for record in records])
        np.testing.assert_array_equal(joined, getattr(everything, name))
    assert resumed.finished


@pytest.mark.parametrize("content", [b"", b"\xff" * 40, b"\x02\0\0\0\0\0\0\0{}", b"\x04\0\0\0\0\0\0\0null"])
def test_a_snapshot_that_is_none_is_refused(content):
    with pytest.raises(LogError, match="state: not"):
        Simulation(A, SHORT, "point_mass", 1).restore(content)


def test_a_snapshot_of_another_flock_is_refused():
    snapshot = Simulation(A, SHORT.replace(drones=5), "point_mass", 1).snapshot()
    with pytest.raises(LogError, match="another scenario"):
        Simulation(A, SHORT, "point_mass", 1).restore(snapshot)


def test_seeds_make_flights():
    flights = [fly(A, scenario=SHORT, dynamics="point_mass", seed=seed) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(flights[0].samples.position, flights[1].samples.position)
    assert not np.array_equal(flights[0].samples.position, flights[2].samples.position)


def test_nothing_touches_the_global_generator():
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    fly(A, scenario=SHORT, dynamics="point_mass")
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002


def test_both_dynamics_start_from_the_same_place_with_the_same_senses():
    flocks = [Simulation(A, SHORT, dynamics, 4) for dynamics in ("point_mass", "rigid_body")]
    records = [simulation.run(0.1) for simulation in flocks]
    np.testing.assert_array_equal(records[0].position[0], records[1].position[0])
    np.testing.assert_array_equal(records[0].desired[1], records[1].desired[1])


def test_the_warm_up_is_left_out():
    whole = fly(A, scenario=SHORT, dynamics="point_mass")
    late = fly(A, scenario=SHORT.replace(warm_up=6.0), dynamics="point_mass")
    expected = twins.order_parameters(whole.samples.position[60:], whole.samples.velocity[60:], A, SHORT)
    np.testing.assert_allclose(late.order_parameters, expected, rtol=1e-10, atol=1e-12)


def test_packets_are_lost_at_the_asked_rate():
    silent = SHORT.replace(packet_loss_ratio=1.0, packet_loss_distance=1e-3, sigma_inner=0.0, sigma_outer=0.0)
    alone = SHORT.replace(r_comm=0.0, sigma_inner=0.0, sigma_outer=0.0)
    flights = [fly(A, scenario=scenario, dynamics="point_mass") for scenario in (silent, alone)]
    np.testing.assert_array_equal(flights[0].samples.position, flights[1].samples.position)


def test_progress_is_reported_and_a_wish_to_stop_ends_the_flight():
    told = []
    scenario = SHORT.replace(duration=40.0)
    flight = fly(
        A,
        scenario=scenario,
        dynamics="point_mass",
        progress=lambda t, fitness: told.append((t, fitness.F_1)),
        stop=lambda: len(told) >= 2,
    )
    assert [t for t, _ in told] == pytest.approx([10.0, 20.0])
    assert flight.flown == pytest.approx(20.0)
    assert not flight.complete
    assert flight.samples.t[-1] == pytest.approx(20.0)


def test_one_drone_flies():
    flight = fly(A, scenario=SHORT.replace(drones=1), dynamics="point_mass")
    assert flight.order_parameters.disc == 1
    assert np.isfinite(flight.fitness).all()


def test_events_tell_breaches_and_near_misses():
    scenario = SHORT.replace(arena_side=40.0, start_spacing=0.0, duration=60.0)
    flight = fly(A, scenario=scenario, dynamics="point_mass")
    kinds = {event.message.split()[0]: event for event in flight.events}
    assert set(kinds) == {"drone", "drones"}
    times = [event.time_ns for event in flight.events]
    assert times == sorted(times)
    breach = kinds["drone"]
    k = round(breach.time_ns * 1e-9 / scenario.sample_period)
    assert np.max(np.abs(flight.samples.position[k, breach.drone, :2])) > 20


@pytest.mark.parametrize(
    ("keywords", "error", "words"),
    [
        ({"dynamics": "boat"}, ScenarioError, "dynamics: 'boat'"),
        ({"seed": -1}, ScenarioError, "seed: -1"),
        ({"seed": 1.5}, ScenarioError, "seed: 1.5"),
        ({"params": A._replace(p_rep=float("nan"))}, PointError, "p_rep: nan"),
        ({"params": A._replace(a_frict=0.0)}, PointError, "a_frict: 0.0"),
        ({"params": A[:5]}, PointError, "holds the parameters of no policy"),
        ({"scenario": SHORT.replace(drones=900)}, ScenarioError, "drones: 900 do not fit"),
    ],
)
def test_what_cannot_be_flown_is_refused_in_one_line(keywords, error, words):
    arguments = {"params": A, "scenario": SHORT, "dynamics": "point_mass"} | keywords
    with pytest.raises(error, match=words) as refusal:
        fly(arguments.pop("params"), **arguments)
    assert "\n" not in str(refusal.value)
    assert isinstance(refusal.value, MoflockError)


GUSTY = Scenario(drones=4, arena_side=100.0, duration=12.0, wind=WindConfig(speed=6.0, turbulence="moderate"))


def test_in_gusts_a_point_mass_that_is_late_by_what_a_step_is_late_anyway_is_one_that_is_not():
    """An answer is held for a step, and so is late by half of one: the gusts must be drawn alike."""
    flights = [
        fly(load_point("B"), scenario=GUSTY.replace(point_mass=response), dynamics="point_mass", seed=3)
        for response in (PointMassConfig(), PointMassConfig(delay=0.004))
    ]
    np.testing.assert_allclose(flights[0].samples.position, flights[1].samples.position, rtol=0, atol=1e-9)


def test_in_gusts_a_late_point_mass_flies_on_with_less_grip():
    late = GUSTY.replace(point_mass=PointMassConfig(delay=0.4), duration=60.0)
    errors = [
        fly(load_point("B"), scenario=scenario, dynamics="point_mass", seed=3).motion.velocity_error_rms
        for scenario in (GUSTY.replace(duration=60.0), late)
    ]
    assert errors[0] < errors[1] < 2 * errors[0]
