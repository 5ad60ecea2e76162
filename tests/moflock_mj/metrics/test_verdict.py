"""Verdicts: each limit decides when it should, and is named."""

import numpy as np
import pytest

from moflock_mj.metrics.verdict import judge
from moflock_mj.scenario.acceptance import AcceptanceLimits
from optimize.evaluation.evaluation import FIGURE_NAMES, figure_columns

GOOD = {"separation_min": 4.0, "saturated_share": 0.001, "altitude_error_max": 0.1, "outside_max": 0.5}


LIMITS = AcceptanceLimits()


def figures(*flights):
    return np.array([[({**GOOD, **changes}).get(name, 0.0) for name in FIGURE_NAMES] for changes in flights])


def judged(*flights, failed=0, limits=LIMITS, diameter=0.4):
    return judge(figure_columns(figures(*flights)), failed, limits, diameter)


def test_a_good_point_is_flyable_and_its_nearest_limit_is_named():
    assert judged({}, {}) == ("flyable", "smallest separation 4 m, limit 1 m")
    assert judged({}, {"altitude_error_max": 0.9}) == ("flyable", "altitude error 0.9 m, limit 1 m")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"separation_min": 0.9}, "smallest separation 0.9 m, limit 1 m"),
        ({"saturated_share": 0.02}, "rotors at their limit 2 % of the time, limit 1 % of the time"),
        ({"altitude_error_max": 1.5}, "altitude error 1.5 m, limit 1 m"),
        ({"outside_max": 7.0}, "outside the arena 7 m, limit 5 m"),
    ],
)
def test_one_limit_passed_in_one_flight_is_marginal(change, words):
    assert judged({}, change, {}) == ("marginal", words)


def test_touches_are_marginal_until_they_are_many():
    twenty = [{}] * 20
    assert judged({"touched": 2}, *twenty) == ("marginal", "drones touched in 1 of 21 flights, at most 2 in one")
    verdict = judged({"touched": 2}, {"touched": 4}, {"touched": 2}, *twenty)
    assert verdict == ("unsafe", "drones touched in 3 of 23 flights, at most 4 in one")
    allowed = AcceptanceLimits(touched_flights=0.5)
    assert judged({"touched": 2}, {"touched": 4}, {"touched": 2}, *twenty, limits=allowed).name == "marginal"


def test_a_lost_drone_or_a_failed_flight_is_unsafe():
    assert judged({"lost": 1, "touched": 2}, {}) == ("unsafe", "drones lost in 1 of 2 flights, at most 1 in one")
    assert judged({}, {}, failed=1) == ("unsafe", "1 of 2 flights failed")


def test_two_diameters_are_the_least_separation():
    assert judged({"separation_min": 1.4}, diameter=0.754) == ("marginal", "smallest separation 1.4 m, limit 1.51 m")


def test_a_drone_alone_is_apart_from_nothing():
    assert judged({"separation_min": np.nan}).name == "flyable"
