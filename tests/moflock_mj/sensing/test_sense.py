"""Sensing and starts: cases with a known answer."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.compiling import Off, entry_kernel
from controllers.policies.interface import Observation
from moflock_mj import Scenario
from moflock_mj.errors import ScenarioError
from moflock_mj.sensing.gps import SensorModel, SensorState, remember
from moflock_mj.sensing.sense import sense
from moflock_mj.simulation.initial_state import make_initial_state
from moflock_mj.world.square import Square, locate_square_walls
from moflock_mj.world.state import TrueState

QUIET = SensorModel(t_gps=0.2, sigma_inner=0.0, lambda_gps=0.1, r_comm=100.0, packet_loss=0.0)


@entry_kernel
def tick(model, state, world, arena, faults, moment, late, gps_noise, loss_draws, observation):
    remember(state, world, moment)
    sense(model, state, world, arena, faults, moment - late, gps_noise, loss_draws, loss_draws, observation)


def ticked(model, state, world, moment, late, *, noise=None, draws=None):
    n = world.position.shape[1]
    observation = Observation.empty(n, 2)
    noise = np.zeros((2, 2, n)) if noise is None else noise
    draws = np.zeros((0, 0)) if draws is None else draws
    tick(model, state, world, Square(500.0), Off(), moment, late, noise, draws, observation)
    return observation


def heard(observation, i):
    return sorted(observation.neighbours[i, : observation.neighbour_count[i]].tolist())


def test_a_packet_holds_what_was_true_when_it_was_sent():
    world = TrueState.at_rest(2)
    state = SensorState.at_start(world, 3)
    for moment in range(8):
        world.position[0] = moment
        world.velocity[1] = 10 * moment
        observation = ticked(QUIET, state, world, moment, 3)
        np.testing.assert_array_equal(observation.own_position[0], moment)
        np.testing.assert_array_equal(observation.received_position[0], max(moment - 3, 0))
        np.testing.assert_array_equal(observation.received_velocity[1], 10 * max(moment - 3, 0))


def test_who_is_heard_goes_by_the_true_distance_now():
    world = TrueState.at_rest(3)
    world.position[0] = (0.0, 99.0, 150.0)
    state = SensorState.at_start(world, 0)
    observation = ticked(QUIET, state, world, 0, 0)
    assert [heard(observation, i) for i in range(3)] == [[1], [0, 2], [1]]
    world.position[2] = (0.0, 0.0, 90.0)
    assert [heard(ticked(QUIET, state, world, 1, 0), i) for i in range(3)] == [[1], [0], []]


def test_packets_are_lost_one_way_with_the_square_of_the_distance():
    world = TrueState.at_rest(2)
    world.position[0] = (0.0, 50.0)
    model = QUIET._replace(packet_loss=0.8 / 100**2)
    state = SensorState.at_start(world, 0)
    draws = np.array([[0.0, 0.21], [0.19, 0.0]])
    observation = ticked(model, state, world, 0, 0, draws=draws)
    assert heard(observation, 0) == [1]
    assert heard(observation, 1) == []


def test_the_two_gps_errors_walk_apart_and_with_the_right_strength():
    drones, ticks = 400, 600
    model = QUIET._replace(sigma_inner=0.005)
    world = TrueState.at_rest(drones)
    state = SensorState.at_start(world, 0)
    rng = np.random.default_rng(3)
    for moment in range(ticks):
        ticked(model, state, world, moment, 0, noise=rng.standard_normal((2, 2, drones)))
    # Of g'' + lambda g' + D g = sqrt(2 lambda sigma) xi with steps of t_gps the velocity's variance tends to
    # about sigma t_gps times the kick's own scaling; held against a slow walk with other numbers.
    lam, t, sigma = model.lambda_gps, model.t_gps, model.sigma_inner
    g, h = np.zeros(20_000), np.zeros(20_000)
    for _ in range(ticks):
        xi = rng.standard_normal(20_000)
        h += np.sqrt(2 * lam * sigma * t) * xi - lam * t * h - np.sqrt(2 * lam * sigma) / 3 * t * g
        g += t * h
    assert np.std(state.velocity_error) == pytest.approx(np.std(h), rel=0.1)
    assert np.std(state.position_error) == pytest.approx(np.std(g), rel=0.1)
    own, sent = state.position_error.reshape(2, -1)
    assert abs(np.corrcoef(own, sent)[0, 1]) < 0.15


def test_walls_of_the_square():
    arena, distance, normal = Square(100.0), np.zeros((2, 2)), np.zeros((2, 2, 2))
    locate_square_walls(arena, np.array([[40.0, -60.0], [-10.0, 0.0]]), distance, normal)
    np.testing.assert_array_equal(distance, [[10, -10], [40, 50]])
    np.testing.assert_array_equal(normal[0], [[-1, 1], [0, 0]])
    np.testing.assert_array_equal(normal[1], [[0, 0], [1, 0]])


def test_a_spaced_start_is_spaced_inside_and_at_rest():
    scenario = Scenario(drones=200)
    world = make_initial_state(scenario, np.random.default_rng(1))
    distance = np.linalg.norm(world.position[:, :, None] - world.position[:, None, :], axis=0)
    assert np.min(distance[~np.eye(200, dtype=bool)]) >= scenario.start_spacing
    assert np.abs(world.position[:2]).max() <= 250
    np.testing.assert_array_equal(world.velocity, 0)
    np.testing.assert_array_equal(world.position[2], scenario.altitude)


def test_a_moflock_start_has_one_common_velocity():
    world = make_initial_state(Scenario(start="moflock"), np.random.default_rng(1))
    assert np.ptp(world.velocity, axis=1).max() == 0
    assert 0 < np.abs(world.velocity[:2]).max() < 1


@pytest.mark.parametrize("drones", [150, 10_000])
def test_more_drones_than_fit_are_refused(drones):
    scenario = Scenario(drones=drones, arena_side=100.0)
    with pytest.raises(ScenarioError, match=f"drones: {drones} .* 100 m"):
        make_initial_state(scenario, np.random.default_rng(1))
