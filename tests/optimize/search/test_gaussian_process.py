"""Regression: neighbours tell of each other, and where nothing is noisy nothing is smoothed."""

import numpy as np
import pytest

from optimize.search import gaussian_process
from optimize.search.gaussian_process import (
    Flights,
    GaussianProcess,
    flight_variance,
    negative_log_marginal_likelihood,
    pooled_variance,
)


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


def slow_covariance(a, b, signal, lengths):
    r = np.sqrt(5 * np.sum(((a - b) / lengths) ** 2))
    return signal * (1 + r + r**2 / 3) * np.exp(-r)


def slow_prediction(flights, variance, lengths, at):
    """Mean and deviation (m, 2) at points `at`, each by its own linear system: the textbook's equations 2.23, 2.24."""
    lengths = lengths * np.ptp(flights.points, axis=0)
    values, noise = flights.mean[:, 0], variance[:, 0] / flights.number
    signal = max(values.var() - noise.mean(), 0.1 * values.var())
    covariance = np.array([[slow_covariance(a, b, signal, lengths) for b in flights.points] for a in flights.points])
    covariance += np.diag(noise)
    prior = np.sum(values / (signal + noise)) / np.sum(1 / (signal + noise))
    found = []
    for point in at:
        k = np.array([slow_covariance(point, b, signal, lengths) for b in flights.points])
        mean = prior + k @ np.linalg.solve(covariance, values - prior)
        found.append((mean, np.sqrt(signal - k @ np.linalg.solve(covariance, k))))
    return np.array(found)


def test_it_is_the_textbooks_regression():
    flights = noisy([2] * 40)
    found = GaussianProcess(flights)
    at = np.random.default_rng(2).random((5, 12))
    wanted = slow_prediction(flights, found._variance, found._processes.lengths[0], at)
    np.testing.assert_allclose(found.predict(at).mean[:, 0], wanted[:, 0], atol=1e-9)
    np.testing.assert_allclose(found.predict(at).deviation[:, 0], wanted[:, 1], atol=1e-7)


def test_the_gradient_of_the_likelihood():
    rng = np.random.default_rng(4)
    points, values, noise, at = rng.random((15, 3)), rng.standard_normal(15), rng.random(15), rng.standard_normal(3)

    def value(log_lengths):
        """Minus the logarithm of a normal density, with the prior of the lengths."""
        covariance = np.array([[slow_covariance(a, b, 0.7, np.exp(log_lengths)) for b in points] for a in points])
        covariance += np.diag(noise)
        likelihood = 0.5 * values @ np.linalg.solve(covariance, values) + 0.5 * np.linalg.slogdet(covariance)[1]
        return likelihood + 0.5 * log_lengths @ log_lengths

    found, gradient = negative_log_marginal_likelihood(at, points, values, noise, 0.7)
    assert found == pytest.approx(value(at))
    nudges = 1e-5 * np.eye(3)
    np.testing.assert_allclose(gradient, [(value(at + n) - value(at - n)) / 2e-5 for n in nudges], rtol=1e-5)


def test_coordinates_that_do_not_matter_are_found_out():
    lengths = GaussianProcess(noisy([2] * 200, deviation=0.05))._processes.lengths[0]
    assert lengths[:2].max() < 0.7 * lengths[2:].min(), "the objective depends on the first two alone"


def test_lengths_are_kept_until_there_are_many_more_points():
    first = GaussianProcess(noisy([2] * 40))
    same = GaussianProcess(noisy([2] * 45, seed=2), first)
    np.testing.assert_array_equal(same._processes.lengths, first._processes.lengths)
    assert (GaussianProcess(noisy([2] * 60, seed=3), same)._processes.lengths != first._processes.lengths).any()


def test_it_is_nearer_to_the_truth_than_the_flights_are():
    flights = noisy([1] * 300 + [3] * 100)
    truth, found = truth_at(flights.points), GaussianProcess(flights).prediction()
    error = np.sqrt(np.mean((found.mean - truth) ** 2))
    assert error < 0.25 * np.sqrt(np.mean((flights.mean - truth) ** 2))
    assert error == pytest.approx(np.sqrt(np.mean(found.deviation**2)), rel=0.5), "it knows how sure it is"


def test_it_foresees_points_that_have_not_flown():
    at = np.random.default_rng(7).random((100, 12))
    found = GaussianProcess(noisy([2] * 400)).predict(at)
    errors = found.mean - truth_at(at)
    assert np.sqrt(np.mean(errors**2)) < 0.06
    assert np.mean(np.abs(errors) < 2 * found.deviation) > 0.8


def test_a_point_that_flew_often_is_believed_itself():
    flights = noisy([1] * 30 + [10_000])
    flights.total[-1], flights.squares[-1] = 0.05 * 10_000, 0.0425 * 10_000
    found = GaussianProcess(flights).prediction()
    assert found.mean[-1, 0] == pytest.approx(0.05, abs=0.01)
    assert found.deviation[-1, 0] < 0.01 < found.deviation[0, 0]


def test_without_repeated_flights_nothing_changes():
    flights = noisy([1] * 10)
    found = GaussianProcess(flights)
    assert not found.noisy
    np.testing.assert_array_equal(found.prediction().mean, flights.mean)
    assert not found.prediction().deviation.any()


def test_the_scatter_is_learnt_where_it_is():
    rng = np.random.default_rng(3)
    points = rng.random((400, 12))
    truth = np.where(points[:, :1] > 0.5, 0.9, 0.3)
    sure, unsure = (flown(points, truth, [3] * 400, rng, deviation) for deviation in (0.02, 0.2))
    high = truth[:, 0] > 0.5
    total, squares = (np.where(high[:, None], a, b) for a, b in zip(sure[2:], unsure[2:], strict=True))
    mixed = Flights(points, sure.number, total, squares)
    found = np.sqrt(flight_variance(mixed, truth))
    assert 0.02 < found[high].mean() < 0.06, "nearer to its own than to the pooled one"
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
    np.testing.assert_allclose(GaussianProcess(flights).mean(), GaussianProcess(stretched).mean(), atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_points_and_equal_ones(count):
    total = np.tile([0.8, 0.8], (count, 1))
    flights = Flights(np.ones((count, 12)), np.full(count, 2.0), total, total**2 / 2 + [0.01, 0.0])
    np.testing.assert_allclose(GaussianProcess(flights).mean(), 0.4)


def test_of_too_many_points_the_surest_and_latest_are_taken(monkeypatch):
    monkeypatch.setattr(gaussian_process, "MAX_POINTS", 20)
    flights = noisy([1] * 30 + [5] * 10)
    found = GaussianProcess(flights).mean()
    assert (found[:20] == flights.mean[:20]).all()
    assert (found[20:] != flights.mean[20:]).all()


def test_a_cheaper_model_shows_what_few_flights_cannot():
    """A model that is right up to its scale and an offset, flown on many points, and the real thing on few."""
    rng = np.random.default_rng(5)
    many, at = rng.random((200, 12)), rng.random((50, 12))
    cheap = GaussianProcess(flown(many, truth_at(many), [20] * 200, rng))
    few = flown(many[:25], 0.2 + 0.6 * truth_at(many[:25]), [2] * 25, rng, 0.1)
    wanted = 0.2 + 0.6 * truth_at(at)
    alone, helped = GaussianProcess(few).predict(at), GaussianProcess(few, None, cheap).predict(at)
    errors = [np.sqrt(np.mean((found.mean - wanted) ** 2)) for found in (alone, helped)]
    assert errors[1] < 0.8 * errors[0]
    assert GaussianProcess(few, None, cheap)._processes._slope[0] == pytest.approx(0.6, abs=0.3)


def test_a_cheaper_model_that_knows_nothing_changes_nothing():
    flights, at = noisy([2] * 40), np.random.default_rng(2).random((5, 12))
    empty = GaussianProcess(Flights(flights.points, np.ones(40), flights.mean, flights.mean**2))
    assert not empty.noisy
    plain, other = GaussianProcess(flights).predict(at), GaussianProcess(flights, None, empty).predict(at)
    assert plain.mean.tobytes() == other.mean.tobytes()
    assert plain.deviation.tobytes() == other.deviation.tobytes()


@pytest.mark.parametrize("helped", [False, True])
def test_points_that_flew_are_believed_to_be_what_is_foreseen_of_them(helped):
    rng = np.random.default_rng(6)
    flights = noisy([2] * 40)
    cheap = GaussianProcess(flown(flights.points, 0.5 * truth_at(flights.points), [20] * 40, rng)) if helped else None
    found = GaussianProcess(flights, None, cheap)
    np.testing.assert_allclose(found.mean(), found.predict(flights.points).mean, atol=1e-12)
