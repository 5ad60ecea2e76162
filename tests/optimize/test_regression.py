"""Regression: neighbours tell of each other, and where nothing is noisy nothing is smoothed."""

import numpy as np
import pytest

from optimize import regression
from optimize.regression import Flights, Regression, flight_variance, pooled_variance


def truth_at(points):
    return 0.5 + 0.3 * np.sin(2 * points[:, :1]) * np.cos(points[:, 1:2])


def flown(points, truth, number, rng, deviation=0.2):
    """Sums over `number` (n,) noisy flights of points (n, 12) whose true objectives are (n, K)."""
    rows = [
        mean + deviation * rng.standard_normal((int(n), truth.shape[1])) for mean, n in zip(truth, number, strict=True)
    ]
    return Flights(
        points=points,
        number=np.asarray(number, np.float64),
        total=np.array([row.sum(axis=0) for row in rows]),
        squares=np.array([(row**2).sum(axis=0) for row in rows]),
    )


def noisy(number, deviation=0.2, seed=1):
    rng = np.random.default_rng(seed)
    points = rng.random((len(number), 12))
    return flown(points, truth_at(points), number, rng, deviation)


def slow_belief(flights, variance, length, at):
    """Mean and deviation (m, K) at points `at`, each by its own linear system: the textbook's equations 2.23, 2.24."""
    width = np.ptp(flights.points, axis=0)
    values, noise = flights.mean[:, 0], variance[:, 0] / flights.number
    scatter = values.var()
    signal = max(scatter - noise.mean(), 0.1 * scatter)

    def kernel(a, b):
        return signal * np.exp(-np.sum(((a - b) / width) ** 2) / (2 * length**2))

    covariance = np.array([[kernel(a, b) for b in flights.points] for a in flights.points]) + np.diag(noise)
    prior = np.sum(values / (signal + noise)) / np.sum(1 / (signal + noise))
    found = []
    for point in at:
        k = np.array([kernel(point, b) for b in flights.points])
        mean = prior + k @ np.linalg.solve(covariance, values - prior)
        found.append((mean, np.sqrt(signal - k @ np.linalg.solve(covariance, k))))
    return np.array(found)


def test_it_is_the_textbooks_regression():
    flights = noisy([2] * 40)
    found = Regression(flights)
    at = np.random.default_rng(2).random((5, 12))
    level = found.mean()
    # The scatter is learnt from a first belief, which with so few points is the belief itself but for its noise.
    variance = found._variance
    np.testing.assert_allclose(variance, flight_variance(flights, level), rtol=0.2)
    wanted = min(
        (slow_belief(flights, variance, length, at) for length in (0.25, 0.5, 1.0, 2.0)),
        key=lambda twin: np.abs(twin[:, 0] - found.foresee(at).mean[:, 0]).max(),
    )
    np.testing.assert_allclose(found.foresee(at).mean[:, 0], wanted[:, 0], atol=1e-9)
    np.testing.assert_allclose(found.foresee(at).deviation[:, 0], wanted[:, 1], atol=1e-7)


def test_it_is_nearer_to_the_truth_than_the_flights_are():
    flights = noisy([1] * 300 + [3] * 100)
    truth, found = truth_at(flights.points), Regression(flights).belief()
    error = np.sqrt(np.mean((found.mean - truth) ** 2))
    assert error < 0.25 * np.sqrt(np.mean((flights.mean - truth) ** 2))
    assert error == pytest.approx(np.sqrt(np.mean(found.deviation**2)), rel=0.5), "it knows how sure it is"


def test_it_foresees_points_that_have_not_flown():
    at = np.random.default_rng(7).random((100, 12))
    found = Regression(noisy([2] * 400)).foresee(at)
    errors = found.mean - truth_at(at)
    assert np.sqrt(np.mean(errors**2)) < 0.06
    assert np.mean(np.abs(errors) < 2 * found.deviation) > 0.8


def test_a_point_that_flew_often_is_believed_itself():
    flights = noisy([1] * 30 + [10_000])
    flights.total[-1], flights.squares[-1] = 0.05 * 10_000, 0.0425 * 10_000
    found = Regression(flights).belief()
    assert found.mean[-1, 0] == pytest.approx(0.05, abs=0.01)
    assert found.deviation[-1, 0] < 0.01 < found.deviation[0, 0]


def test_without_repeated_flights_nothing_changes():
    flights = noisy([1] * 10)
    found = Regression(flights)
    assert not found.noisy
    np.testing.assert_array_equal(found.belief().mean, flights.mean)
    assert not found.belief().deviation.any()


def test_the_scatter_is_learnt_where_it_is():
    rng = np.random.default_rng(3)
    points = rng.random((400, 12))
    truth = np.where(points[:, :1] > 0.5, 0.9, 0.3)
    sure, unsure = (flown(points, truth, [3] * 400, rng, deviation) for deviation in (0.02, 0.2))
    high = truth[:, 0] > 0.5
    total, squares = (np.where(high[:, None], a, b) for a, b in zip(sure[2:], unsure[2:], strict=True))
    mixed = Flights(points, sure.number, total, squares)
    found = np.sqrt(flight_variance(mixed, truth))
    np.testing.assert_allclose(found[high], 0.02, atol=0.01)
    np.testing.assert_allclose(found[~high], 0.2, atol=0.02)


def test_the_pooled_variance_of_repeated_flights():
    flights = Flights(
        np.zeros((3, 1)), np.array([1.0, 2.0, 3.0]), *np.array([[[5.0], [3.0], [6.0]], [[9.0], [5.0], [14.0]]])
    )
    # Sums of squares about the means: 0, 5 - 4.5 and 14 - 12, over 0 + 1 + 2 repeats; the first one has no say.
    assert pooled_variance(flights) == pytest.approx([2.5 / 3])
    assert not pooled_variance(flights._replace(number=np.ones(3))).any()


def test_the_scale_of_a_coordinate_does_not_matter():
    flights = noisy([2] * 50)
    stretched = flights._replace(points=100 * flights.points - 7)
    np.testing.assert_allclose(Regression(flights).mean(), Regression(stretched).mean(), atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_points_and_equal_ones(count):
    total = np.tile([0.8, 0.8], (count, 1))
    flights = Flights(np.ones((count, 12)), np.full(count, 2.0), total, total**2 / 2 + [0.01, 0.0])
    np.testing.assert_allclose(Regression(flights).mean(), 0.4)


def test_of_too_many_points_the_surest_and_latest_are_taken(monkeypatch):
    monkeypatch.setattr(regression, "MOST", 20)
    flights = noisy([1] * 30 + [5] * 10)
    found = Regression(flights).mean()
    assert (found[:20] == flights.mean[:20]).all()
    assert (found[20:] != flights.mean[20:]).all()
