"""Smoothing: neighbours tell of each other, and where nothing is noisy nothing is smoothed."""

import numpy as np
import pytest

from optimize import smoothing
from optimize.smoothing import smooth


def noisy(count, flights, deviation=0.2, seed=1):
    """Points (n, 12), their true objective (n, 1), and its mean over noisy flights."""
    rng = np.random.default_rng(seed)
    points = rng.random((count, 12))
    truth = 0.5 + 0.3 * np.sin(2 * points[:, :1]) * np.cos(points[:, 1:2])
    return points, truth, truth + deviation / np.sqrt(flights)[:, None] * rng.standard_normal((count, 1))


def test_it_is_nearer_to_the_truth_than_the_flights_are():
    flights = np.ones(400)
    points, truth, mean = noisy(400, flights)
    found = smooth(points, flights, mean, np.array([0.04]), deviation=True)
    error = np.sqrt(np.mean((found.mean - truth) ** 2))
    assert error < 0.25 * np.sqrt(np.mean((mean - truth) ** 2))
    assert error == pytest.approx(np.sqrt(np.mean(found.deviation**2)), rel=0.5), "it knows how sure it is"


def test_a_point_that_flew_often_is_believed_itself():
    flights = np.array([1.0] * 30 + [10_000.0])
    points, _, mean = noisy(31, flights)
    mean[-1] = 0.05
    found = smooth(points, flights, mean, np.array([0.04]), deviation=True)
    assert found.mean[-1, 0] == pytest.approx(0.05, abs=0.01)
    assert found.deviation[-1, 0] < 0.01 < found.deviation[0, 0]


def test_without_noise_nothing_changes():
    points, _, mean = noisy(10, np.ones(10))
    found = smooth(points, np.ones(10), mean, np.zeros(1), deviation=True)
    np.testing.assert_array_equal(found.mean, mean)
    assert not found.deviation.any()


def test_the_scale_of_a_coordinate_does_not_matter():
    flights = np.ones(50)
    points, _, mean = noisy(50, flights)
    stretched = 100 * points - 7
    one, two = (smooth(where, flights, mean, np.array([0.04])).mean for where in (points, stretched))
    np.testing.assert_allclose(one, two, atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_points_and_equal_ones(count):
    found = smooth(np.ones((count, 12)), np.ones(count), np.full((count, 2), 0.4), np.array([0.01, 0.0]))
    np.testing.assert_allclose(found.mean, 0.4)


def test_of_too_many_points_the_surest_and_latest_are_taken(monkeypatch):
    monkeypatch.setattr(smoothing, "MOST", 20)
    flights = np.array([1.0] * 30 + [5.0] * 10)
    points, _, mean = noisy(40, flights)
    found = smooth(points, flights, mean, np.array([0.04]), deviation=True)
    assert (found.mean[:20] == mean[:20]).all()
    assert (found.mean[20:] != mean[20:]).all()
    assert found.deviation[0, 0] == pytest.approx(0.2)
