"""Estimates: dominance, hypervolume, and how sure a mean is."""

import numpy as np
import pytest

from moflock_mj.parameters.points import load_point
from optimize.evaluation.evaluation import Evaluation
from optimize.evaluation.objectives import PAPER
from optimize.search.estimates import estimated_front, estimates, hypervolume, non_dominated


def flown(number, point, objectives):
    """An evaluation with the given (F_1, F_2) per flight."""
    fitness = np.array([[f_1, 1, f_2, 1, 1, 1] for f_1, f_2 in objectives])
    return Evaluation(
        number,
        point,
        tuple(range(len(fitness))),
        np.zeros_like(fitness),
        fitness,
        np.ones((len(fitness), 12)),
        0.1,
        "me",
        "ok",
    )


def test_non_dominated_points():
    values = [[1, 0], [0.5, 0.5], [0.4, 0.5], [0, 1], [0.5, 0.5], [0, 0]]
    assert non_dominated(values).tolist() == [True, True, False, True, True, False]


def test_hypervolume_of_rectangles():
    assert hypervolume([[0.5, 0.8]]) == pytest.approx(0.4)
    assert hypervolume([[0.5, 0.8], [1.0, 0.2], [0.1, 0.1]]) == pytest.approx(0.5)


def test_flights_of_one_point_are_gathered():
    a, b = load_point("A"), load_point("B")
    found = estimates([flown(0, a, [(0.5, 0.2)]), flown(1, b, [(0.1, 0.9)]), flown(2, a, [(0.7, 0.4)])], PAPER)
    assert [estimate.flights for estimate in found] == [2, 1]
    assert [estimate.params for estimate in found] == [a, b]


def test_where_each_point_flew_once_the_mean_is_its_flight():
    a, b = load_point("A"), load_point("B")
    found = estimates([flown(0, a, [(0.5, 0.2)]), flown(1, b, [(0.1, 0.9)])], PAPER)
    assert [estimate.mean.tolist() for estimate in found] == [[0.5, 0.2], [0.1, 0.9]]
    assert not found[0].std_error.any()


def test_one_lucky_flight_does_not_make_the_front():
    a, b = load_point("A"), load_point("B")
    steady = [flown(i, a, [(0.6 + 0.1 * (-1) ** i, 0.6)]) for i in range(40)]
    front = estimated_front([*steady, flown(40, b, [(0.65, 0.6)])], PAPER)
    assert [estimate.params for estimate in front] == [a]
