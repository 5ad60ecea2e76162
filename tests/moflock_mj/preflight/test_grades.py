"""Grades: the worst of the parts is that of the whole."""

from __future__ import annotations

import math

import pytest

from moflock_mj.preflight.results import Grade, judged


@pytest.mark.parametrize(
    ("grades", "worst"),
    [
        ([], Grade.OFF),
        ([Grade.OFF, Grade.PASS], Grade.PASS),
        ([Grade.WARNING, Grade.PASS], Grade.WARNING),
        ([Grade.RUNNING, Grade.WARNING], Grade.RUNNING),
        ([Grade.SOFT_FAILURE, Grade.RUNNING], Grade.SOFT_FAILURE),
        ([Grade.FAILURE, Grade.SOFT_FAILURE], Grade.FAILURE),
        ([Grade.FAILURE, Grade.ERROR, Grade.PASS], Grade.ERROR),
    ],
)
def test_the_worst_grade_is_that_of_the_whole(grades, worst):
    assert Grade.worst(grades) is worst


def test_one_may_fly_with_warnings_and_with_nothing_worse():
    assert [grade for grade in Grade if grade.is_good] == [Grade.OFF, Grade.PASS, Grade.WARNING]


def test_what_fails_says_what_to_do_and_what_passes_does_not():
    asked = {"value": 3.0, "limit": "at most 2 m", "unit": "m", "advice": "move it"}
    assert judged("a", "flock", good=True, **asked).advice == ""
    failed = judged("a", "flock", good=False, **asked)
    assert (failed.grade, failed.advice, failed.value) == (Grade.FAILURE, "move it", 3.0)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_a_value_that_is_not_finite_is_left_out(value):
    assert judged("a", "flock", good=False, value=value, limit="", advice="do").value is None
