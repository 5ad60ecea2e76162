"""The loitering policy against its slow twin, and cases with a known answer."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.policies import vasarhelyi
from controllers.policies.interface import Observation, SpeedLimits
from controllers.policies.target_tracking import TargetTrackingParams, decide
from controllers.policies.vasarhelyi import VasarhelyiParams
from moflock_mj import Scenario, load_point
from moflock_mj.world.square import Square, locate_square_walls
from tests.support import twins

SCENARIO = Scenario(v_max=100.0)
"""No cut, so that the pull can be separated from the rest."""
LIMITS = SpeedLimits(SCENARIO.v_flock, SCENARIO.v_max, SCENARIO.v_rep_max)
OFF = VasarhelyiParams(0.0, 0.0, 0.0, 5.0, 1.0, 100.0, 0.0, -1e5, 0.0, 5.0, 1.0, 0.0)
"""Parameters whose every term is off."""


def observation(position, velocity, neighbours):
    """Knowledge of drones that know the truth; arrays (N, 2), neighbours a list of lists."""
    known = Observation.empty(len(position), 2)
    for array, values in zip(known, (position, velocity, position, velocity), strict=False):
        array[:] = np.asarray(values, float).T
    for i, heard in enumerate(neighbours):
        known.neighbours[i, : len(heard)] = heard
        known.neighbour_count[i] = len(heard)
    locate_square_walls(Square(500.0), known.own_position, known.wall_distance, known.wall_normal)
    return known


def decided(params, target, known, limits=LIMITS):
    out = np.zeros_like(known.own_position)
    decide(TargetTrackingParams(params, *target), limits, known, out)
    return out.T


def slow_pull(own, heard, target):
    """Of one drone: 2 m/s towards the target and 2 m/s towards the middle, together at most 2 m/s."""
    pull = np.zeros(2)
    middle = np.mean([own, *heard], axis=0)
    for towards, beyond in ((target - own, 2.0), (middle - own, 40.0)):
        distance = np.linalg.norm(towards)
        if distance > beyond:
            pull += 2.0 * towards / distance
    length = np.linalg.norm(pull)
    return pull * min(1.0, 2.0 / length) if length > 0 else pull


@pytest.mark.parametrize("seed", range(20))
def test_agrees_with_its_slow_twin(seed):
    rng = np.random.default_rng(seed)
    params = VasarhelyiParams(*(np.array(load_point("AB"[seed % 2])) * rng.uniform(0.7, 1.3, 12)))
    n, spread = 10, (20, 60, 270)[seed % 3]
    position, velocity = rng.uniform(-spread, spread, (n, 2)), rng.normal(0, 3, (n, 2))
    target = rng.uniform(-100, 100, 2)
    neighbours = [[j for j in range(n) if j != i and rng.random() < 0.7] for i in range(n)]
    ours = decided(params, tuple(target), observation(position, velocity, neighbours))
    for i in range(n):
        heard = [(position[j], velocity[j]) for j in neighbours[i]]
        flock = twins.desired_velocity(params, SCENARIO, position[i], velocity[i], heard)
        pull = slow_pull(position[i], [place for place, _ in heard], target)
        np.testing.assert_allclose(ours[i], flock + pull, rtol=1e-10, atol=1e-10)


def test_a_far_target_pulls_with_2_metres_a_second_and_a_reached_one_not_at_all():
    known = observation([[0, 0], [0, 98.5], [0, 97.9]], np.zeros((3, 2)), [[], [], []])
    np.testing.assert_allclose(decided(OFF, (0.0, 100.0), known), [[0, 2], [0, 0], [0, 2]])


def test_a_drone_that_strays_is_pulled_to_the_middle_of_those_it_hears_and_itself():
    at_target = (0.0, 0.0)
    far = observation([[0, 0], [90, 0]], np.zeros((2, 2)), [[1], []])
    np.testing.assert_allclose(decided(OFF, at_target, far)[0], [2, 0])
    near = observation([[0, 0], [79, 0]], np.zeros((2, 2)), [[1], []])
    np.testing.assert_allclose(decided(OFF, at_target, near)[0], [0, 0])


def test_both_pulls_together_are_2_metres_a_second_at_most():
    known = observation([[0, 0], [90, 0]], np.zeros((2, 2)), [[1], []])
    np.testing.assert_allclose(decided(OFF, (0.0, 100.0), known)[0], [np.sqrt(2), np.sqrt(2)])
    np.testing.assert_allclose(decided(OFF, (-100.0, 0.0), known)[0], [0, 0], atol=1e-12)


def test_without_a_pull_it_is_the_flocking_policy():
    rng = np.random.default_rng(0)
    known = observation([[0, 0], [10, 5]], rng.normal(0, 3, (2, 2)), [[1], [0]])
    expected = np.zeros((2, 2))
    vasarhelyi.decide(load_point("B"), LIMITS._replace(v_max=6.0), known, expected)
    ours = decided(load_point("B"), (0.0, 1.0), known, LIMITS._replace(v_max=6.0))
    np.testing.assert_array_equal(ours[0], expected.T[0])


def test_the_answer_is_cut_to_v_max():
    known = observation([[0, 0]], [[0, 6.0]], [[]])
    assert np.linalg.norm(decided(OFF, (0.0, 100.0), known, LIMITS._replace(v_max=6.0))) == pytest.approx(6)
