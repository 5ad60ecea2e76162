"""Principal components of data whose components are known, and the grouping that follows from them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from moflock_mj import Scenario
from moflock_mj.errors import SearchError
from moflock_mj.parameters.bounds import policy_bounds
from optimize.analysis.pca import (
    agreement,
    components_json,
    fitness_components,
    grouped_by_sign,
    load_components,
    principal_components,
    random_points,
)
from optimize.analysis.published_results import COVARIANCE, FIRST_COMPONENT
from optimize.evaluation.objectives import FITNESS_NAMES, Objectives


def samples_of(covariance, count, rng):
    """Samples whose covariance over count - 1 is exactly this one."""
    raw = rng.normal(size=(count, len(covariance)))
    raw -= raw.mean(axis=0)
    whitened = raw @ np.linalg.inv(np.linalg.cholesky(np.cov(raw, rowvar=False))).T
    return whitened @ np.linalg.cholesky(covariance).T


def test_recovers_the_components_of_constructed_data():
    covariance = np.array([[1.0, 0.8, -0.3], [0.8, 1.0, -0.2], [-0.3, -0.2, 1.0]])
    data = samples_of(covariance, 400, np.random.default_rng(1)) * [1.0, 20.0, 0.01] + [5.0, -3.0, 0.0]
    found = principal_components(data, "abc")
    np.testing.assert_allclose(found.covariance, covariance * 400 / 399, rtol=1e-9)
    values, vectors = np.linalg.eigh(covariance)
    np.testing.assert_allclose(found.explained, values[::-1] / 3, rtol=1e-9)
    for component, vector in zip(found.components, vectors.T[::-1], strict=True):
        assert abs(component @ vector) == pytest.approx(1)
    np.testing.assert_allclose(found.mean, data.mean(axis=0))


def test_the_diagonal_is_the_papers():
    found = fitness_components(np.random.default_rng(0).random((500, 6)))
    np.testing.assert_allclose(np.diag(found.covariance), 1.002, atol=5e-6)


def test_the_papers_covariance_gives_the_papers_component_and_grouping():
    data = samples_of((COVARIANCE + COVARIANCE.T) / 2 / 1.002, 500, np.random.default_rng(2))
    found = fitness_components(data)
    near = agreement(found)
    assert near.cosine > 0.999
    assert near.same_signs
    assert near.covariance_error < 0.001
    assert grouped_by_sign(found).groups == (("wall", "speed"), ("corr", "coll", "disc", "cluster"))
    assert abs(FIRST_COMPONENT @ FIRST_COMPONENT - 1) < 0.005


def test_a_fitness_that_never_varies_is_left_out_of_the_components():
    data = samples_of((COVARIANCE + COVARIANCE.T) / 2 / 1.002, 100, np.random.default_rng(3))
    data[:, 3] = 1.0
    found = fitness_components(data)
    assert found.constant == ("coll",)
    assert found.components[0, 3] == 0
    assert all(np.isfinite(array).all() for array in (found.covariance, found.components, found.explained))
    assert "coll" in grouped_by_sign(found).groups[1]


def test_what_cannot_be_analysed_is_refused():
    with pytest.raises(SearchError, match="none of them varies"):
        fitness_components(np.ones((10, 6)))
    with pytest.raises(SearchError, match="too few"):
        fitness_components(np.ones((1, 6)))
    bad = np.random.default_rng(0).random((10, 6))
    bad[3, 2] = np.nan
    with pytest.raises(SearchError, match="corr"):
        fitness_components(bad)


def test_weights_of_one_sign_make_no_two_objectives():
    shared = np.random.default_rng(0).normal(size=(50, 1))
    with pytest.raises(SearchError, match="one sign"):
        grouped_by_sign(fitness_components(np.repeat(shared, 6, axis=1)))


@pytest.mark.parametrize("sampling", ["uniform", "latin_hypercube"])
def test_random_points_lie_in_the_bounds_and_follow_their_generator(sampling):
    bounds = policy_bounds()
    first, second = (random_points(bounds, 40, np.random.default_rng(7), sampling) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    unit = bounds.to_unit(first)
    assert unit.min() >= 0
    assert unit.max() <= 1
    if sampling == "latin_hypercube":
        slices = np.sort(np.floor(unit * 40), axis=0)
        np.testing.assert_array_equal(slices, np.arange(40)[:, None].repeat(12, axis=1))


def test_an_unknown_sampling_is_refused():
    with pytest.raises(SearchError, match="sobol"):
        random_points(policy_bounds(), 10, np.random.default_rng(0), "sobol")


def test_the_file_is_read_as_objectives_and_as_an_analysis(tmp_path):
    found = fitness_components(samples_of((COVARIANCE + COVARIANCE.T) / 2, 100, np.random.default_rng(3)))
    objectives = grouped_by_sign(found, Scenario(drones=20))
    path = tmp_path / "pca.json"
    path.write_text(components_json(found, objectives))
    assert Objectives.from_json(path.read_text()) == objectives
    again = load_components(path)
    assert again.names == FITNESS_NAMES
    np.testing.assert_array_equal(again.components, found.components)
    path.write_text(json.dumps({"objectives": {}}))
    with pytest.raises(SearchError, match=r"pca\.json"):
        load_components(path)
