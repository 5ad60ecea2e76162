"""A small version of `make fidelity`: a few seeds of a few points, with limits that chance does not reach."""

from __future__ import annotations

import numpy as np
import pytest

from tests.fidelity.robotsim import F_LIMIT, JUDGED, compare, paper_rows, reference_points


@pytest.mark.slow
@pytest.mark.parametrize("name", ["model_optimum", "A", "r06"])
def test_a_point_agrees_with_robotsim(name):
    params, theirs = reference_points()[name]
    comparison = compare(name, params, theirs, range(1, 9))
    assert max(abs(comparison.z[phi]) for phi in JUDGED) < 4.5
    assert np.mean([comparison.z[phi] ** 2 for phi in JUDGED]) < 4.0
    for objective in F_LIMIT:
        assert abs(comparison.f_difference[objective]) < 0.3


@pytest.mark.slow
def test_points_a_and_b_are_within_a_deviation_of_the_paper():
    for point, objective, ours, mean, deviation in paper_rows(range(1, 21)):
        assert abs(ours - mean) <= deviation, (point, objective)
