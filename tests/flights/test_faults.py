"""Whole flights in which something breaks: they degrade as a user expects, and logs and snapshots keep all of it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from moflock_mj import Scenario, fly, load_point, read_log
from moflock_mj.analysis.verification import resume, verify
from moflock_mj.scenario.faults import KINDS, FaultConfig
from moflock_mj.simulation.simulation import Simulation
from tests.support import twins

POINT = load_point("model_optimum")
EXAMPLE = Scenario.load(Path(__file__).parents[2] / "docs" / "faulty.toml")
FLOCK = Scenario(drones=10, arena_side=300.0, duration=30.0)
PERFECT = FLOCK.replace(sigma_inner=0.0, sigma_outer=0.0, start="moflock")
"""Without noise, and in motion from the start."""

BOTH = pytest.mark.parametrize("dynamics", ["rigid_body", "point_mass"])
WEAK = {"kind": "rotor_failure", "rotor": 1}
MANY = (
    FaultConfig(kind="gps_loss", at=1.0, duration=6.5, drone=0),
    FaultConfig(kind="gps_jump", at=2.1, duration=3.0, drone=1, jump=(5.0, -3.0)),
    FaultConfig(kind="cannot_transmit", at=2.3, duration=2.2, drone=2),
    FaultConfig(kind="cannot_receive", at=3.0, duration=1.5, drone=3),
    FaultConfig(kind="cannot_receive", at=8.1, duration=0.4),
    FaultConfig(kind="link_loss", at=4.0, duration=2.0, share=0.5),
    FaultConfig(kind="link_loss", at=5.0, duration=2.0, drone=3, share=0.3),
    FaultConfig(kind="power_off", at=5.3, drone=4),
)


def outside(flight):
    """m, by which the farthest drone was beyond a wall."""
    return np.abs(flight.samples.position[..., :2]).max() - flight.scenario.arena_side / 2


def neighbours(simulation, i):
    """Those that drone i goes by, with how many ticks ago it heard them last: {number: ticks}."""
    observation, drones = simulation.memory.observation, simulation.scenario.drones
    columns = observation.neighbours[i, : observation.neighbour_count[i]].tolist()
    return {column % drones: column // drones for column in columns}


def heard_now(simulation, i):
    return {j for j, ticks in neighbours(simulation, i).items() if ticks == 0}


@pytest.mark.parametrize("changes", [{}, {"t_del": 0.3}, {"t_del": 0.0, "r_comm": 40.0}])
def test_point_masses_with_faults_are_those_of_their_slow_twin(changes):
    scenario = Scenario(drones=6, arena_side=80.0, duration=10.0, faults=MANY).replace(**changes)
    flight = fly(POINT, scenario=scenario, dynamics="point_mass", seed=3)
    slow = twins.SlowFlight(POINT, scenario, 3).fly()
    np.testing.assert_allclose(flight.samples.position, [x for x, _ in slow.samples], rtol=0, atol=1e-7)
    np.testing.assert_allclose(flight.samples.velocity, [v for _, v in slow.samples], rtol=0, atol=1e-7)


@BOTH
def test_until_a_fault_begins_the_flight_is_that_without_it(dynamics):
    """Bit by bit, up to the sample of that moment."""
    whole = fly(POINT, scenario=FLOCK.replace(duration=6.0), dynamics=dynamics, seed=2).samples
    broken = FLOCK.replace(duration=6.0, faults=(FaultConfig(kind="power_off", at=4.0, drone=5),))
    broken = fly(POINT, scenario=broken, dynamics=dynamics, seed=2).samples
    for name in ("position", "velocity", "desired_velocity", "nearest"):
        np.testing.assert_array_equal(getattr(whole, name)[:41], getattr(broken, name)[:41])
    assert (whole.position[41, 5] != broken.position[41, 5]).any()


@BOTH
def test_without_neighbours_drones_keep_to_the_arena_and_to_their_speed(dynamics):
    scenario = FLOCK.replace(duration=90.0, faults=(FaultConfig(kind="cannot_receive"),))
    simulation = Simulation(POINT, scenario, dynamics, 1)
    record = simulation.run(90.0)
    assert simulation.memory.observation.neighbour_count.max() == 0
    beyond = np.abs(record.position[..., :2]).max() - scenario.arena_side / 2
    assert beyond < 5.0
    assert np.linalg.norm(record.velocity[300:], axis=2).mean() == pytest.approx(scenario.v_flock, rel=0.15)
    travelled = np.ptp(record.position[:, :, :2], axis=0)
    assert travelled.max(axis=1).min() > 100.0  # every one of them crosses the arena


@BOTH
def test_a_drone_that_loses_gps_slows_and_holds_and_then_flies_on(dynamics):
    scenario = FLOCK.replace(duration=60.0, faults=(FaultConfig(kind="gps_loss", at=20.0, duration=20.0, drone=3),))
    samples = fly(POINT, scenario=scenario, dynamics=dynamics, seed=4).samples
    speed = np.linalg.norm(samples.velocity[..., :2], axis=2)
    assert speed[150:200, 3].mean() > 4.0
    assert speed[250:400, 3].mean() < 1.0
    assert np.ptp(samples.position[250:400, 3, :2], axis=0).max() < 8.0
    assert (samples.desired_velocity[201:401, 3] == 0).all()
    assert speed[500:, 3].mean() > 4.0
    assert speed[250:400, [0, 1, 2, 4, 5, 6, 7, 8, 9]].mean() > 4.0


def test_a_point_mass_without_gps_stops_after_its_stopping_distance_and_reports_it():
    """V' = -v / tau, from v: it stops after v tau."""
    scenario = PERFECT.replace(faults=(FaultConfig(kind="gps_loss", at=10.0, drone=3),), arena_side=100.0)
    simulation = Simulation(POINT, scenario, "point_mass", 4)
    simulation.run(10.0)
    place, velocity = (
        array[:2, 3].copy() for array in (simulation.memory.world.position, simulation.memory.world.velocity)
    )
    heard = []
    for _ in range(50):
        simulation.run(0.2)
        heard.append(any(3 in heard_now(simulation, i) for i in range(10)))
    assert np.linalg.norm(velocity) > 1
    stopped = simulation.memory.world.position[:2, 3] - place
    np.testing.assert_allclose(stopped, velocity * scenario.tau, rtol=2e-3)
    assert all(heard)


@BOTH
def test_a_jump_is_read_at_once_and_sent_a_delay_later(dynamics):
    scenario = PERFECT.replace(faults=(FaultConfig(kind="gps_jump", at=2.0, duration=3.0, drone=1, jump=(5.0, -2.0)),))
    simulation, truth, read, heard = Simulation(POINT, scenario, dynamics, 1), [], [], []
    for _ in range(40):
        truth.append(simulation.memory.world.position[:2].copy())
        simulation.run(0.2)
        read.append(simulation.memory.observation.own_position.copy())
        heard.append(simulation.memory.observation.received_position[:, :10].copy())
    jumps = np.zeros((40, 2, 10))
    jumps[10:25, :, 1] = 5.0, -2.0
    told = np.array(truth) + jumps
    np.testing.assert_allclose(read, told, rtol=0, atol=1e-9)
    np.testing.assert_allclose(heard[5:], told[:-5], rtol=0, atol=1e-9)


@BOTH
def test_a_silent_drone_is_heard_until_its_last_packet_arrives_and_then_kept_for_a_second(dynamics):
    """What is kept is the last packet, carried on by its velocity."""
    scenario = PERFECT.replace(
        arena_side=60.0, start="spaced", faults=(FaultConfig(kind="cannot_transmit", at=4.0, duration=3.0, drone=2),)
    )
    simulation, ticks, told = Simulation(POINT, scenario, dynamics, 1), [], []
    for _ in range(50):
        world = simulation.memory.world
        told.append((world.position[:2, 2].copy(), world.velocity[:2, 2].copy()))
        simulation.run(0.2)
        ticks.append([neighbours(simulation, i).get(2) for i in range(10) if i != 2])
        assert len(heard_now(simulation, 2)) == 9
        if 25 <= len(ticks) - 1 < 30:
            age = ticks[-1][0]
            place, velocity = told[19]  # the packet of 3.8 s, the last before it fell silent
            carried = simulation.memory.observation.received_position[:, 2 + 10 * age]
            np.testing.assert_allclose(carried, place + age * 0.2 * velocity, rtol=0, atol=1e-9)
    each = [0] * 25 + [1, 2, 3, 4, 5] + [None] * 10 + [0] * 10
    assert ticks == [[tick] * 9 for tick in each]


@BOTH
def test_a_blackout_deafens_one_and_all(dynamics):
    faults = (
        FaultConfig(kind="cannot_receive", at=1.0, duration=2.0, drone=0),
        FaultConfig(kind="cannot_receive", at=2.0, duration=1.0),
    )
    simulation = Simulation(POINT, PERFECT.replace(arena_side=60.0, faults=faults), dynamics, 1)
    counts = []
    for _ in range(20):
        simulation.run(0.2)
        counts.append([len(heard_now(simulation, i)) for i in range(10)])
    np.testing.assert_array_equal(np.array(counts)[:, 0], [9] * 5 + [0] * 10 + [9] * 5)
    np.testing.assert_array_equal(np.array(counts)[:, 1:], np.repeat([[9] * 10 + [0] * 5 + [9] * 5], 9, axis=0).T)


@BOTH
def test_drones_that_are_cut_off_stop_and_hold_until_they_hear_again(dynamics):
    """All of them a second after the blackout begins, when the last packets are too old."""
    scenario = FLOCK.replace(duration=60.0, faults=(FaultConfig(kind="cannot_receive", at=20.0, duration=20.0),))
    flight = fly(POINT, scenario=scenario, dynamics=dynamics, seed=4)
    speed = np.linalg.norm(flight.samples.velocity[..., :2], axis=2)
    assert speed[150:200].mean() > 4.0
    assert speed[270:400].mean() < 1.0
    assert speed[500:].mean() > 4.0
    assert (flight.samples.desired_velocity[205] != 0).any()
    assert (flight.samples.status[-1] & 4 == 0).all()


def test_a_drone_whose_only_neighbour_falls_silent_flies_on():
    """It is the other's radio that may be broken."""
    scenario = PERFECT.replace(
        drones=2, arena_side=60.0, faults=(FaultConfig(kind="cannot_transmit", at=2.0, drone=1),)
    )
    samples = fly(POINT, scenario=scenario, dynamics="point_mass", seed=1).samples
    assert np.linalg.norm(samples.desired_velocity[40:, 0], axis=1).min() > 0


@BOTH
def test_a_burst_loses_its_share_of_packets_each_way(dynamics):
    faults = (FaultConfig(kind="link_loss", at=2.0, duration=20.0, drone=0, share=0.25),)
    simulation, receives, is_heard = (
        Simulation(POINT, PERFECT.replace(arena_side=60.0, faults=faults), dynamics, 1),
        [],
        [],
    )
    for _ in range(120):
        simulation.run(0.2)
        receives.append(len(heard_now(simulation, 0)))
        is_heard.append(sum(0 in heard_now(simulation, i) for i in range(1, 10)))
    for counts in (receives, is_heard):
        assert counts[:10] == [9] * 10
        assert np.mean(counts[10:110]) == pytest.approx(9 * 0.75, abs=0.45)  # three deviations
        assert counts[110:] == [9] * 10


@BOTH
def test_a_drone_that_is_switched_off_falls_alone(dynamics):
    scenario = FLOCK.replace(faults=(FaultConfig(kind="power_off", at=10.0, drone=5),))
    flight = fly(POINT, scenario=scenario, dynamics=dynamics, seed=1)
    samples, others = flight.samples, [i for i in range(10) if i != 5]
    falls, spin_down = samples.position[100:121, 5, 2], 0.6 if dynamics == "rigid_body" else 1e-9
    assert falls == pytest.approx(20 - 9.81 / 2 * (np.arange(21) / 10) ** 2, abs=spin_down)
    assert samples.position[130:, 5, 2].max() < 1.0
    assert np.linalg.norm(samples.velocity[150:, 5], axis=1).mean() < 0.2  # the outer noise nudges a body that lies
    assert np.abs(samples.position[:, others, 2] - 20).max() < 1.0
    assert np.linalg.norm(samples.velocity[150:, others], axis=2).mean() > 4.0
    touched = (samples.status[-1] & 4) > 0
    assert [event.message for event in flight.events if event.level == "error"] == ["drone 5 touched the ground"]
    np.testing.assert_array_equal(np.flatnonzero(touched), [5])


def test_a_weak_rotor_is_held_and_a_lost_one_is_not():
    """Of twice its weight in thrust it can spare 0.3 of a rotor; without one it tumbles, falls and is not heeded."""
    weak = FLOCK.replace(faults=(FaultConfig(**WEAK, at=10.0, drone=5, effectiveness=0.7),))
    flight = fly(POINT, scenario=weak, seed=1)
    assert flight.body.touched == 0
    assert flight.body.altitude_error_max < 1.0

    lost = FLOCK.replace(faults=(FaultConfig(**WEAK, at=10.0, drone=5, effectiveness=0.0),))
    simulation = Simulation(POINT, lost, "rigid_body", 1)
    record, others = simulation.run(30.0), [i for i in range(10) if i != 5]
    assert record.position[150:, 5, 2].max() < 2.0
    np.testing.assert_array_equal(np.flatnonzero(simulation.memory.world.touched), [5])
    assert np.abs(record.position[:, others, 2] - 20).max() < 1.0
    assert np.linalg.norm(record.velocity[150:, others], axis=2).mean() > 4.0
    assert not any(5 in neighbours(simulation, i) for i in others)


@BOTH
def test_it_is_the_same_however_it_is_cut_and_from_any_snapshot(dynamics):
    """Cut in the middle of every fault, and between a fault's beginning and its first tick."""
    faults = MANY + (FaultConfig(**WEAK, at=3.0, duration=4.0, drone=1, effectiveness=0.6),) * (
        dynamics == "rigid_body"
    )
    scenario = FLOCK.replace(duration=10.0, drones=6, arena_side=100.0, faults=faults)
    whole = Simulation(POINT, scenario, dynamics, 5).run(10.0)
    simulation, records = Simulation(POINT, scenario, dynamics, 5), []
    for seconds in (0.9, 0.2, 1.1, 0.2, 1.2, 0.9, 0.9, 0.2, 2.6, 10.0):
        resumed = Simulation(POINT, scenario, dynamics, 999)
        resumed.restore(simulation.snapshot())
        simulation = resumed
        records.append(simulation.run(seconds))
    for name in ("position", "velocity", "desired", "status", "order_parameters"):
        joined = np.concatenate([getattr(record, name) for record in records])
        np.testing.assert_array_equal(joined, getattr(whole, name))


@BOTH
def test_its_log_has_the_faults_and_is_verified_and_resumed(tmp_path, dynamics):
    scenario = FLOCK.replace(duration=13.0, drones=6, arena_side=100.0, faults=MANY)
    path = tmp_path / "a.mcap"
    flight = fly(POINT, scenario=scenario, dynamics=dynamics, seed=3, log=path)
    logged = read_log(path)
    assert logged.scenario == scenario
    assert logged.events == flight.events
    assert verify(logged).identical
    again = resume(logged, 10.0)
    np.testing.assert_array_equal(again.samples.position[-1], flight.samples.position[-1])
    told = [event.message for event in flight.events if event.level == "warning" and "apart" not in event.message]
    assert len(told) == 2 * len(MANY) - 1
    assert (told[0], told[-1]) == ("drone 0: no GPS", "all drones: cannot receive (over)")


def test_the_example_has_every_kind_and_loses_but_two():
    assert {fault.kind for fault in EXAMPLE.faults} == set(KINDS)
    flight = fly(POINT, scenario=EXAMPLE, seed=1)
    np.testing.assert_array_equal(np.flatnonzero(flight.samples.status[-1] & 4), [7, 8])
    assert outside(flight) < 5.0
    assert math.isfinite(flight.fitness.product)
