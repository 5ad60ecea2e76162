"""Order parameters and fitness against their slow twin, and cases with a known answer."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.compiling import entry_kernel
from controllers.policies.vasarhelyi import interaction_range
from moflock_mj import OrderParameters, Scenario, load_point
from moflock_mj.metrics.fitness import falling, fitness_of, gaussian, rising
from moflock_mj.metrics.order_parameters import (
    CLOSE,
    OUTSIDE,
    TOUCHED,
    MetricAccumulator,
    MetricRanges,
    count_sample,
    write_running,
)
from moflock_mj.world.square import Square
from moflock_mj.world.state import TrueState
from tests.support import twins


@entry_kernel
def judge(positions, velocities, touched, arena, ranges, accumulator, out):
    for k in range(positions.shape[0]):
        world = TrueState(positions[k], velocities[k], touched)
        nearest = count_sample(world, arena, ranges, True, accumulator)
    write_running(accumulator, out)
    return nearest


def judged(positions, velocities, scenario, r_cluster, touched=None):
    """Order parameters of samples (T, N, 3), and the sums behind them."""
    n = positions.shape[1]
    accumulator, out = MetricAccumulator.empty(n, 2), np.zeros(6)
    touched = np.zeros(n, np.uint8) if touched is None else touched
    nearest = judge(
        np.ascontiguousarray(positions.swapaxes(1, 2)),
        np.ascontiguousarray(velocities.swapaxes(1, 2)),
        touched,
        Square(scenario.arena_side),
        MetricRanges(r_cluster, scenario.r_coll),
        accumulator,
        out,
    )
    return OrderParameters(*out), accumulator, nearest


@pytest.mark.parametrize("name", ["A", "B", "model_optimum"])
@pytest.mark.parametrize("spread", [10.0, 300.0, 1000.0])
def test_agree_with_their_slow_twin(name, spread):
    rng = np.random.default_rng(5)
    scenario, params = Scenario(), load_point(name)
    positions = rng.uniform(-spread / 2, spread / 2, (7, 9, 3))
    velocities = rng.normal(0, 4, (7, 9, 3))
    velocities[2, 3] = 0
    ours, _, _ = judged(positions, velocities, scenario, interaction_range(params, scenario.v_flock))
    np.testing.assert_allclose(ours, twins.order_parameters(positions, velocities, params, scenario), rtol=1e-12)


def test_two_drones_in_formation():
    positions = np.array([[[0.0, 0, 0], [2.0, 0, 0]]])
    velocities = np.array([[[3.0, 4.0, 0], [3.0, 4.0, 0]]])
    ours, accumulator, nearest = judged(positions, velocities, Scenario(drones=2), 50.0)
    assert ours == pytest.approx((0, 5, 1, 1, 0, 1))
    assert nearest == pytest.approx(2.0)
    assert list(accumulator.status) == [CLOSE, CLOSE]


def test_opposed_far_and_outside():
    positions = np.array([[[255.0, 0, 0], [-100.0, 0, 0], [-110.0, 0, 0]]])
    velocities = np.array([[[1.0, 0, 0], [1.0, 0, 0], [-1.0, 0, 0]]])
    touched = np.array([0, 1, 0], np.uint8)
    ours, accumulator, _ = judged(positions, velocities, Scenario(drones=3), 50.0, touched)
    assert ours == pytest.approx((5, 1, -2 / 3, 0, 1, 0))
    assert list(accumulator.status) == [OUTSIDE, TOUCHED, 0]


def test_one_drone_has_nothing_to_correlate_with():
    ours, _, nearest = judged(np.zeros((1, 1, 3)), np.ones((1, 1, 3)), Scenario(drones=1), 50.0)
    assert ours == pytest.approx((0, np.sqrt(3), 0, 0, 1, 0))
    assert nearest == np.inf


def test_transfer_functions_at_known_places():
    np.testing.assert_allclose(rising([3.0, 3.75, 4.875, 6.0, 9.0], 6.0, 2.25), [0, 0, 0.5, 1, 1], atol=1e-15)
    np.testing.assert_allclose(gaussian([0.0, 5.0], 5.0), [1, np.exp(-1)])
    np.testing.assert_allclose(falling([0.0, 6.0], 6.0), [1, 0.25])


def test_fitness_multiplies_the_papers_groups():
    scenario = Scenario()
    fitness = fitness_of(OrderParameters(5.0, 4.875, 0.8, 0.0003, 6.0, 3.0), scenario)
    assert fitness.wall == pytest.approx(np.exp(-1))
    assert pytest.approx(np.exp(-1) * 0.5) == fitness.F_1
    assert pytest.approx(0.025) == fitness.F_2
    assert fitness.product == pytest.approx(fitness.F_1 * fitness.F_2)
    assert fitness_of(OrderParameters(0, 6, -0.3, 0, 0, 6), scenario).corr == 0
