"""The policy against its slow twin, and cases with a known answer."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.policies.braking import braking_curve, braking_distance
from controllers.policies.interface import Observation, SpeedLimits
from controllers.policies.vasarhelyi import VasarhelyiParams, decide
from moflock_mj import Scenario, load_point
from moflock_mj.world.square import Square, locate_square_walls
from tests.support import twins

SCENARIO = Scenario()
LIMITS = SpeedLimits(SCENARIO.v_flock, SCENARIO.v_max, SCENARIO.v_rep_max)


def observation(position, velocity, received_position, received_velocity, neighbours, side=500.0):
    """Knowledge of drones; arrays (N, 2), neighbours a list of lists."""
    n = len(position)
    known = Observation.empty(n, 2)
    for array, values in zip(known, (position, velocity, received_position, received_velocity), strict=False):
        array[:] = np.asarray(values, float).T
    for i, heard in enumerate(neighbours):
        known.neighbours[i, : len(heard)] = heard
        known.neighbour_count[i] = len(heard)
    locate_square_walls(Square(side), known.own_position, known.wall_distance, known.wall_normal)
    return known


def decided(params, known, limits=LIMITS):
    out = np.zeros_like(known.own_position)
    decide(params, limits, known, out)
    return out.T


def off(**changes):
    """Parameters whose every term is off, but for the changes."""
    still = VasarhelyiParams(0.0, 0.0, 0.0, 5.0, 1.0, 100.0, 0.0, -1e5, 0.0, 5.0, 1.0, 0.0)
    return still._replace(**changes)


@pytest.mark.parametrize("seed", range(30))
def test_agrees_with_its_slow_twin(seed):
    rng = np.random.default_rng(seed)
    points = [load_point(name) for name in ("A", "B", "model_optimum")]
    params = VasarhelyiParams(*(np.mean(points, axis=0) * rng.uniform(0.7, 1.3, 12)))
    n = 12
    position = rng.uniform(-270, 270, (n, 2)) if seed % 2 else rng.uniform(-60, 60, (n, 2))
    velocity = rng.normal(0, 3, (n, 2))
    received_position, received_velocity = position + rng.normal(0, 3, (n, 2)), velocity + rng.normal(0, 1, (n, 2))
    neighbours = [[j for j in range(n) if j != i and rng.random() < 0.8] for i in range(n)]
    known = observation(position, velocity, received_position, received_velocity, neighbours)
    ours = decided(params, known)
    for i in range(n):
        heard = [(received_position[j], received_velocity[j]) for j in neighbours[i]]
        expected = twins.desired_velocity(params, SCENARIO, position[i], velocity[i], heard)
        np.testing.assert_allclose(ours[i], expected, rtol=1e-12, atol=1e-12)


def test_a_lone_drone_flies_on_at_v_flock():
    known = observation([[0, 0]], [[0.3, 0.4]], [[0, 0]], [[0, 0]], [[]])
    np.testing.assert_allclose(decided(off(), known), [[3.6, 4.8]])


def test_a_drone_at_rest_stays_at_rest():
    known = observation([[0, 0]], [[0, 0]], [[0, 0]], [[0, 0]], [[]])
    np.testing.assert_array_equal(decided(off(), known), [[0, 0]])


def test_repulsion_is_a_spring_cut_at_v_rep_max():
    params = off(r0_rep=30.0, p_rep=0.1)
    limits = LIMITS._replace(v_rep_max=1.5)
    for distance, expected in ((20.0, -1.0), (5.0, -1.5), (30.0, 0.0), (50.0, 0.0)):
        known = observation(
            [[0, 0], [distance, 0]], np.zeros((2, 2)), [[0, 0], [distance, 0]], np.zeros((2, 2)), [[1], []]
        )
        np.testing.assert_allclose(decided(params, known, limits)[0], [expected, 0])


def test_alignment_takes_its_share_of_a_velocity_difference_beyond_the_slack():
    params = off(v_frict=1.0, c_frict=0.25)
    position = [[0, 0], [0, 0.0]]
    known = observation(position, [[0, 0], [5, 0]], position, [[0, 0], [5, 0]], [[1], []])
    np.testing.assert_allclose(decided(params, known)[0], [0.25 * (5 - 1), 0])


def test_alignment_lowers_velocity_differences():
    rng = np.random.default_rng(0)
    params = off(v_frict=0.1, c_frict=0.05, r0_frict=1000.0)
    position, velocity = rng.uniform(-20, 20, (8, 2)), rng.normal(0, 1, (8, 2))
    limits = LIMITS._replace(v_flock=0.0)
    known = observation(position, velocity, position, velocity, [[j for j in range(8) if j != i] for i in range(8)])
    after = velocity + 0.5 * decided(params, known, limits)
    assert np.var(after, axis=0).sum() < np.var(velocity, axis=0).sum()


def test_the_wall_asks_a_drone_beyond_it_for_the_shill_velocity():
    params = off(r0_shill=0.0, v_shill=5.0, c_shill=1.0)
    limits = SpeedLimits(0.0, 100.0, 6.0)
    known = observation([[260, 0]], [[0.0, 0.0]], [[0, 0]], [[0, 0]], [[]])
    np.testing.assert_allclose(decided(params, known, limits), [[-5.0, 0.0]])


def test_the_answer_is_cut_to_v_max():
    params = off(r0_shill=0.0, v_shill=50.0, c_shill=1.0)
    known = observation([[260, 260]], [[3.0, 0.0]], [[0, 0]], [[0, 0]], [[]])
    assert np.linalg.norm(decided(params, known)) == pytest.approx(SCENARIO.v_max)


@pytest.mark.parametrize("a", [0.5, 5.0])
@pytest.mark.parametrize("p", [0.3, 4.0])
def test_braking_curve_and_distance_are_inverse_and_smooth(a, p):
    for v in (0.1, a / p - 1e-9, a / p, a / p + 1e-9, 7.0):
        assert braking_curve(braking_distance(v, a, p), a, p) == pytest.approx(v, rel=1e-6)
        assert braking_distance(v, a, p) == pytest.approx(twins.braking_distance(v, a, p), rel=1e-12)
    for x in (-1.0, 0.0, 0.01, a / p**2, 10.0):
        assert braking_curve(x, a, p) == pytest.approx(twins.braking_curve(x, a, p), rel=1e-12)
