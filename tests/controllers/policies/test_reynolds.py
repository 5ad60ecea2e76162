"""Reynolds' policy: its slow twin, and closed forms."""

import math

import numpy as np
import pytest

from controllers.policies.interface import Observation, SpeedLimits
from controllers.policies.reynolds import CLOSEST, NEIGHBOURS, ReynoldsParams, decide

PARAMS = ReynoldsParams(150.0, 0.02, 0.8, 0.3, 13.6, 3.02, 3.55, 1.0)
LIMITS = SpeedLimits(6.0, 6.0, 6.0)
FAST = SpeedLimits(6.0, 1e6, 6.0)


def observation(position, velocity, neighbours, wall_distance=1e3):
    """What drones know that know the truth; arrays (N, 2), neighbours a list of lists."""
    known = Observation.empty(len(position), 1)
    for array, values in zip(known, (position, velocity, position, velocity), strict=False):
        array[:] = np.asarray(values, float).T
    for i, received in enumerate(neighbours):
        known.neighbours[i, : len(received)] = received
        known.neighbour_count[i] = len(received)
    known.wall_distance[:] = wall_distance
    known.wall_normal[:, 0] = 1.0
    return known


def decided(known, limits=FAST, params=PARAMS):
    out = np.zeros_like(known.own_position)
    decide(params, limits, known, out)
    return out.T


def slow(position, velocity, neighbours, i):
    """The rule as it is written: means over the nearest neighbours, and self-propulsion."""
    nearest = sorted(neighbours[i], key=lambda j: math.dist(position[i], position[j]))[:NEIGHBOURS]
    terms = []
    for j in nearest:
        r, v = np.subtract(position[j], position[i]), np.subtract(velocity[j], velocity[i])
        distance = max(np.linalg.norm(r), CLOSEST)
        terms.append(-PARAMS.k_sep * r / distance**2 + PARAMS.k_coh * r + PARAMS.k_align * v)
    speed = np.linalg.norm(velocity[i])
    return LIMITS.v_flock * np.asarray(velocity[i]) / speed + (np.mean(terms, axis=0) if terms else 0.0)


def test_it_agrees_with_its_slow_twin():
    rng = np.random.default_rng(2)
    position, velocity = rng.uniform(-60, 60, (20, 2)), rng.normal(0, 3, (20, 2))
    neighbours = [[j for j in rng.permutation(20) if j != i][: rng.integers(0, 20)] for i in range(20)]
    ours = decided(observation(position, velocity, neighbours))
    for i in range(20):
        np.testing.assert_allclose(ours[i], slow(position, velocity, neighbours, i), rtol=1e-12)


def test_two_drones_neither_attract_nor_repel_each_other_at_the_distance_of_rest():
    rest = math.sqrt(PARAMS.k_sep / PARAMS.k_coh)
    for distance, sign in ((rest, 0), (0.8 * rest, -1), (1.25 * rest, 1)):
        known = observation([[0, 0], [distance, 0]], [[0, 0], [0, 0]], [[1], [0]])
        assert np.sign(np.round(decided(known)[0, 0], 9)) == sign


def test_one_common_heading_is_a_fixed_point():
    rest = math.sqrt(PARAMS.k_sep / PARAMS.k_coh)
    known = observation([[0, 0], [rest, 0]], [[0, 6.0], [0, 6.0]], [[1], [0]])
    np.testing.assert_allclose(decided(known), [[0, 6.0], [0, 6.0]], atol=1e-12)


def test_drones_in_one_place_get_finite_velocities():
    known = observation([[0, 0], [0, 0]], [[0, 0], [0, 0]], [[1], [0]])
    assert np.isfinite(decided(known)).all()


def test_a_near_wall_turns_the_drone_and_v_max_limits_it():
    known = observation([[0, 0]], [[-6.0, 0]], [[]], wall_distance=0.0)
    velocity = decided(known, LIMITS)[0]
    assert velocity[0] == pytest.approx(6.0)
