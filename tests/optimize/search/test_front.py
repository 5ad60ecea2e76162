"""Fronts with known hypervolumes, knees and choices."""

from __future__ import annotations

import dataclasses
import json
import types

import numpy as np
import pytest

from controllers.policies.vasarhelyi import VasarhelyiParams
from moflock_mj import Scenario, load_point
from moflock_mj.errors import SearchError
from moflock_mj.parameters.bounds import policy_bounds
from moflock_mj.scenario import effect_configs
from optimize.evaluation.batch import evaluate_batch, fresh_seeds
from optimize.evaluation.evaluation import Evaluation
from optimize.evaluation.objectives import PAPER
from optimize.search.estimates import hypervolume, non_dominated
from optimize.search.front import best_with, candidates, choose, fly_front, knee, load_front, point_json

SCENARIO = Scenario(drones=4, duration=10)


def evaluation(task, fitness, outcome="ok"):
    return Evaluation(
        number=task.number,
        params=task.params,
        seeds=task.seeds,
        order_parameters=np.zeros((len(task.seeds), 6)),
        fitness=fitness,
        figures=np.zeros((len(task.seeds), 12)),
        seconds=0.0,
        worker="test",
        outcome=outcome,
    )


def trade_off():
    """An executor without flights: c_shill is F_1, v_frict / 3 is F_2, and the seed moves both; answers come late."""

    def evaluate(tasks):
        for task in reversed(tasks):
            shift = 0.01 * (task.seeds[0] % 2) - 0.005
            yield evaluation(
                task, np.array([[task.params.c_shill + shift, 1, task.params.v_frict / 3 + shift, 1, 1, 1]])
            )

    return types.SimpleNamespace(evaluate=evaluate)


def points(*pairs):
    """Points whose objectives with `trade_off` are these."""
    middle = VasarhelyiParams(*np.mean([policy_bounds().lower, policy_bounds().upper], axis=0))
    return np.array([middle._replace(c_shill=f_1, v_frict=3 * f_2) for f_1, f_2 in pairs])


def params(*pairs):
    """The same as parameters of the policy."""
    return [VasarhelyiParams(*point) for point in points(*pairs).tolist()]


def flown(*pairs, seeds=4):
    return fly_front(
        points(*pairs),
        trade_off(),
        objectives=PAPER,
        scenario=SCENARIO,
        dynamics="point_mass",
        policy="vasarhelyi",
        seeds=fresh_seeds(seeds),
        origin={"algorithm": "none"},
    )


CURVE = ((0.95, 0.2), (0.9, 0.8), (0.5, 0.9), (0.85, 0.7))


def test_hypervolume_of_known_fronts():
    assert hypervolume([[0.5, 0.4]]) == pytest.approx(0.2)
    assert hypervolume([[1.0, 0.25], [0.5, 0.5], [0.4, 0.4]]) == pytest.approx(0.25 + 0.5 * 0.25)
    steps = np.linspace(0, 1, 2001)
    assert hypervolume(np.stack([steps, 1 - steps], axis=1)) == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("objectives", [2, 3])
def test_non_dominated_agrees_with_brute_force(objectives):
    values = np.random.default_rng(0).integers(0, 6, (60, objectives)).astype(float)
    expected = [not any((w >= v).all() and (w > v).any() for w in values) for v in values]
    np.testing.assert_array_equal(non_dominated(values), expected)


def test_the_knee_of_a_circle_is_in_its_middle_whatever_the_scales():
    angle = np.linspace(0, np.pi / 2, 91)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert knee(circle) == 45
    assert knee(circle * [3.0, 0.1] + [7.0, -2.0]) == 45


def test_the_knee_of_a_corner_is_the_corner():
    assert knee([[1.0, 0.0], [0.95, 0.9], [0.5, 0.95], [0.0, 1.0]]) == 1
    assert knee([[0.4, 0.4]]) == 0


def test_seeds_are_fresh():
    assert fresh_seeds(4, {1, 3, 4}) == (2, 5, 6, 7)


def test_answers_in_any_order_find_their_point_and_seed():
    answers = evaluate_batch(trade_off(), params((0.4, 0.3), (0.6, 0.5)), [[1, 2], [3, 4]])
    np.testing.assert_allclose(answers.fitness[:, :, 0], [[0.405, 0.395], [0.605, 0.595]])


def test_failed_flights_are_counted_and_worth_nothing():
    def evaluate(tasks):
        for task in tasks:
            ok = task.seeds[0] != 2
            yield evaluation(task, np.full((1, 6), float(ok)), "ok" if ok else "worker died")

    answers = evaluate_batch(types.SimpleNamespace(evaluate=evaluate), params((0.5, 0.5)), [[1, 2, 3]])
    np.testing.assert_array_equal(answers.failed, [1])
    np.testing.assert_array_equal(answers.fitness[0, :, 0], [1, 0, 1])


def test_the_flown_front_has_the_means_of_its_flights():
    front = flown(*CURVE)
    np.testing.assert_allclose(front.mean, CURVE)
    np.testing.assert_allclose(front.deviation, np.sqrt(4 / 3) * 0.005)
    np.testing.assert_allclose(front.half_width, 3.182446 * np.sqrt(4 / 3) * 0.005 / 2, rtol=1e-6)  # Student's t, 3
    np.testing.assert_array_equal(front.remaining, [0, 1, 2])
    assert (front.best(0), front.knee, front.best(1)) == (0, 1, 2)
    assert front.hypervolume == pytest.approx(0.95 * 0.2 + 0.9 * 0.6 + 0.5 * 0.1)


def test_choosing():
    front = flown(*CURVE)
    assert choose(front) == 1
    assert choose(front, weights=(1, 0)) == 0
    assert choose(front, weights=(0.1, 1)) == 2
    assert choose(front, min_f1=0.6) == 1
    assert choose(front, min_f1=0.93) == 0
    assert best_with(front, 0, kept=1, least=0.85) == 2


@pytest.mark.parametrize(
    ("asked", "named"),
    [
        ({"min_f1": 0.99}, "0.950"),
        ({"weights": (1, 1, 1)}, "2 numbers"),
        ({"weights": (0, 0)}, "not all 0"),
        ({"weights": (-1, 2)}, "at least 0"),
        ({"weights": (1, 1), "min_f1": 0.5}, "one of them"),
    ],
)
def test_a_choice_that_cannot_be_made_is_refused(asked, named):
    with pytest.raises(SearchError, match=named):
        choose(flown(*CURVE), **asked)


def test_a_chosen_point_is_one_that_can_be_flown_and_says_where_it_is_from(tmp_path):
    front = flown(*CURVE)
    path = tmp_path / "knee.json"
    path.write_text(point_json(front, front.knee, rule="knee"))
    assert load_point(str(path)) == VasarhelyiParams(*front.points[1])
    provenance = json.loads(path.read_text())["provenance"]
    assert provenance["objectives"]["F_1"]["mean"] == pytest.approx(0.9)
    assert provenance["scenario"] == {"drones": 4, "duration": 10.0}
    assert provenance["algorithm"] == "none"


@pytest.mark.parametrize("sections", [{}, {"wind": effect_configs.WindConfig(speed=8.0)}])
def test_a_front_is_read_as_it_was_written(tmp_path, sections):
    front = dataclasses.replace(flown(*CURVE), scenario=SCENARIO.replace(**sections))
    path = tmp_path / "front.json"
    path.write_text(front.to_json())
    again = load_front(path)
    np.testing.assert_array_equal(again.fitness, front.fitness)
    assert (again.scenario, again.objectives, again.seeds) == (front.scenario, front.objectives, front.seeds)
    path.write_text('{"points": []}')
    with pytest.raises(SearchError, match=r"front\.json"):
        load_front(path)


def test_candidates_come_front_by_front():
    def row(number, f_1, f_2, seed=1):
        params = VasarhelyiParams(*points((f_1, f_2))[0])
        task = types.SimpleNamespace(number=number, params=params, seeds=(seed,))
        return evaluation(task, np.array([[f_1, 1, f_2, 1, 1, 1]]))

    rows = [row(0, 0.9, 0.3), row(1, 0.3, 0.9), row(2, 0.2, 0.2), row(3, 0.6, 0.6)]
    chosen = candidates(rows, PAPER, 3)
    assert {tuple(point) for point in chosen} == {tuple(rows[k].params) for k in (0, 1, 3)}
    assert len(candidates(rows, PAPER, 10)) == 4
    assert len(candidates([], PAPER)) == 0


def test_no_points_or_one_seed_make_no_front():
    with pytest.raises(SearchError, match="no points"):
        flown()
    with pytest.raises(SearchError, match="at least 2"):
        flown(*CURVE, seeds=1)
