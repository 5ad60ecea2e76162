"""Grades: the worst of the parts is that of the whole."""

from __future__ import annotations

import math

import pytest

from moflock_mj.preflight.results import CheckResult, check


@pytest.mark.parametrize(
    ("grades", "worst"),
    [
        ([], CheckResult.OFF),
        ([CheckResult.OFF, CheckResult.PASS], CheckResult.PASS),
        ([CheckResult.WARNING, CheckResult.PASS], CheckResult.WARNING),
        ([CheckResult.RUNNING, CheckResult.WARNING], CheckResult.RUNNING),
        ([CheckResult.SOFT_FAILURE, CheckResult.RUNNING], CheckResult.SOFT_FAILURE),
        ([CheckResult.FAILURE, CheckResult.SOFT_FAILURE], CheckResult.FAILURE),
        ([CheckResult.FAILURE, CheckResult.ERROR, CheckResult.PASS], CheckResult.ERROR),
    ],
)
def test_the_worst_grade_is_that_of_the_whole(grades, worst):
    assert CheckResult.worst(grades) is worst


def test_one_may_fly_with_warnings_and_with_nothing_worse():
    assert [result for result in CheckResult if result.is_good] == [
        CheckResult.OFF,
        CheckResult.PASS,
        CheckResult.WARNING,
    ]


def test_what_fails_says_what_to_do_and_what_passes_does_not():
    asked = {"value": 3.0, "limit": "at most 2 m", "unit": "m", "advice": "move it"}
    assert check("a", "flock", good=True, **asked).advice == ""
    failed = check("a", "flock", good=False, **asked)
    assert (failed.result, failed.advice, failed.value) == (CheckResult.FAILURE, "move it", 3.0)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_a_value_that_is_not_finite_is_left_out(value):
    assert check("a", "flock", good=False, value=value, limit="", advice="do").value is None
