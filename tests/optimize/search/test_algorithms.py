"""The algorithms and the plan of flights, on a cheap problem."""

import numpy as np
import pytest

from optimize.search.algorithms import make_algorithm
from optimize.search.allocation import BudgetAllocator, EvaluationHistory, noise_policy
from optimize.search.configuration import ALGORITHMS, SINGLE_OBJECTIVE
from optimize.search.gaussian_process import Prediction

NOISE = ("fixed", "common", "refly")


def objectives_of(points, noise=0.0):
    """(n, 1, 2): a trade-off along the first coordinate, best where all others are 0.3."""
    distance = np.abs(points[:, 1:] - 0.3).mean(axis=1)
    trade = np.stack([np.sqrt(np.abs(points[:, 0])), np.sqrt(np.abs(1 - points[:, 0]))], axis=1)
    return np.clip(trade - distance[:, None] + noise, 0, 1)[:, None, :]


def nothing_known(points):  # noqa: ARG001
    return None


def global_state():
    return str(np.random.get_state(legacy=False))  # noqa: NPY002 - it is the one that must stay as it is


def make(name, noise="refly", seed=1, budget=600, population=12, seeds=1):
    objectives = 1 if name in SINGLE_OBJECTIVE else 2
    policy = noise_policy(noise, population)
    return BudgetAllocator(
        make_algorithm(name, 12, objectives, population, seed, offspring_per_slot=policy.offspring_per_slot),
        policy,
        population=population,
        dimensions=12,
        objectives=objectives,
        seeds=seeds,
        budget=budget,
        rng=np.random.default_rng(seed),
    )


def run(plan, single):
    trials = []
    while (asked := plan.ask()) is not None:
        values = objectives_of(asked.points)
        plan.tell(np.repeat(values.prod(axis=2, keepdims=True) if single else values, len(asked.seeds[0]), axis=1))
        trials.append(asked)
    return trials


@pytest.mark.parametrize("noise", ["refly", *(pytest.param(noise, marks=pytest.mark.slow) for noise in NOISE[:2])])
@pytest.mark.parametrize("name", ALGORITHMS)
def test_each_algorithm_improves_stays_in_the_cube_and_within_its_budget(name, noise):
    before = global_state()
    plan = make(name, noise)
    trials = run(plan, name in SINGLE_OBJECTIVE)
    flown = np.concatenate([asked.points for asked in trials])
    assert flown.min() >= 0
    assert flown.max() <= 1
    assert 0.9 * 600 <= sum(len(seeds) for asked in trials for seeds in asked.seeds) <= 600
    values = objectives_of(flown)[:, 0].prod(axis=1)
    assert values[-50:].max() > values[:12].max() + 0.05
    assert global_state() == before, "NumPy's global generator was touched"


@pytest.mark.parametrize("name", ALGORITHMS)
def test_the_same_seed_asks_the_same(name):
    first, second, other = (run(make(name, seed=seed, budget=150), name in SINGLE_OBJECTIVE) for seed in (4, 4, 5))
    for one, two in zip(first, second, strict=True):
        assert one.points.tobytes() == two.points.tobytes()
        assert one.seeds == two.seeds
    assert first[0].points.tobytes() != other[0].points.tobytes()


def test_what_others_draw_from_the_global_generator_changes_nothing():
    plan, again = make("cmaes", budget=60), make("cmaes", budget=60)
    first = run(plan, True)
    second = []
    while (asked := again.ask()) is not None:
        np.random.random(7)  # noqa: NPY002 - it is the one that others use
        again.tell(objectives_of(asked.points).prod(axis=2, keepdims=True))
        second.append(asked)
    assert all(a.points.tobytes() == b.points.tobytes() for a, b in zip(first, second, strict=True))


@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_budget_of_one_generation_flies_it(name):
    (asked,) = run(make(name, budget=12), name in SINGLE_OBJECTIVE)
    assert len(asked.points) == 12


def test_seeds_are_fixed_or_common_to_a_generation_or_of_each_evaluation():
    fixed, common, own = ([asked.seeds for asked in run(make("nsga2", noise, seeds=2), False)] for noise in NOISE)
    assert len({pair for seeds in fixed for pair in seeds}) == 1
    assert all(len(set(seeds)) == 1 for seeds in common)
    assert len({seeds[0] for seeds in common}) == len(common)
    pairs = [pair for seeds in own for pair in seeds]
    assert len(set(pairs)) == len(pairs)
    assert all(len(set(pair)) == 2 for pair in (*pairs, *(seeds[0] for seeds in common)))


def test_leaders_fly_again():
    counts = {}
    for asked in run(make("nsga2"), False):
        for point in asked.points:
            counts[point.tobytes()] = counts.get(point.tobytes(), 0) + 1
    assert max(counts.values()) >= 4


@pytest.mark.parametrize("name", ["nsga2", "unsga3"])
def test_the_most_promising_offspring_fly(name):
    """All that is known of points is how far their first coordinate is: only those far along it are flown."""
    algorithm = make_algorithm(name, 12, 2, 10, 1, offspring_per_slot=20)
    offspring = []

    def predict(points):
        offspring.append(points)
        return Prediction(np.repeat(points[:, :1], 2, axis=1), np.zeros((len(points), 2)))

    first = algorithm.ask(predict)
    algorithm.tell(lambda points: np.full((len(points), 2), 0.5), first[:0])
    flown = algorithm.ask(predict)
    assert len(first) == len(flown) == 10
    assert [len(points) for points in offspring] == [200]
    np.testing.assert_array_equal(np.sort(flown[:, 0]), np.sort(offspring[0][:, 0])[-10:])


@pytest.mark.parametrize("name", ["nsga2", "unsga3"])
def test_points_to_start_from_are_in_the_first_generation_and_random_ones_fill_it_up(name):
    start = np.full((3, 12), 0.25) + np.arange(3)[:, None] / 10
    first = make_algorithm(name, 12, 2, 10, 1, start=start).ask(nothing_known)
    assert len(first) == 10
    np.testing.assert_array_equal(first[:3], start)
    assert len(np.unique(first[3:, 0])) == 7
    offspring = []
    make_algorithm(name, 12, 2, 10, 1, offspring_per_slot=4, first_offspring_per_slot=4, start=start).ask(
        offspring.append
    )
    assert len(offspring[0]) == 40
    np.testing.assert_array_equal(offspring[0][:3], start)


def test_what_may_turn_out_better_is_flown_before_what_is_sure():
    algorithm = make_algorithm("nsga2", 12, 2, 10, 1, offspring_per_slot=20)
    algorithm.tell(lambda points: np.full((len(points), 2), 0.5), algorithm.ask(nothing_known)[:0])
    flown = algorithm.ask(
        lambda points: Prediction(np.full((len(points), 2), 0.5), np.repeat(points[:, 1:2], 2, axis=1))
    )
    assert flown[:, 1].min() > 0.7


def test_an_unbounded_search_leaves_the_cube():
    algorithm = make_algorithm("cmaes", 12, 1, 12, 1, unbounded=True)
    for _ in range(10):
        points = algorithm.ask(nothing_known)
        algorithm.tell(lambda points: points.sum(axis=1, keepdims=True), points[:0])
    assert points.max() > 1


def test_nan_never_reaches_an_algorithm():
    plan = make("nsga2")
    asked = plan.ask()
    with pytest.raises(ValueError, match="not finite"):
        plan.tell(np.full((len(asked.points), 1, 2), np.nan))


@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_search_in_which_all_is_infeasible_spends_its_budget(name):
    plan, flights = make(name, budget=100), 0
    while (asked := plan.ask()) is not None:
        assert np.isfinite(asked.points).all()
        flights += sum(map(len, asked.seeds))
        plan.tell(np.zeros((len(asked.points), 1, 1 if name in SINGLE_OBJECTIVE else 2)))
    assert 100 - 12 < flights <= 100


def test_the_memory_judges_and_lets_those_lead_that_flew_least():
    memory, points = EvaluationHistory(12, 2), np.random.default_rng(1).random((3, 12))
    memory.add(points, np.array([[[1.0, 0.0]], [[0.0, 1.0]], [[0.0, 0.0]]]))
    memory.add(points[:1], np.array([[[1.0, 0.0]]]))
    np.testing.assert_allclose(memory.score(points[[1, 0]]), [[0.0, 1.0], [1.0, 0.0]])
    assert memory.leaders(2).tobytes() == points[[1, 0]].tobytes()
    assert len(memory.unknown(np.concatenate([points, np.zeros((2, 12))]))) == 1
