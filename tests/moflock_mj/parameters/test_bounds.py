"""Bounds: the paper's, the unit cube, what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from moflock_mj.errors import SearchError
from moflock_mj.parameters.bounds import ParameterBounds, bounds_of, load_bounds, policy_bounds

PAPER = json.loads((Path(__file__).parents[2] / "reference" / "paper.json").read_text())["bounds"]


def test_paper_bounds_are_the_papers():
    assert list(policy_bounds().lower) == PAPER["lower"]
    assert list(policy_bounds().upper) == PAPER["upper"]


def test_the_unit_cube_maps_to_the_bounds_and_back():
    bounds = policy_bounds()
    unit = np.random.default_rng(1).random((5, 12))
    points = bounds.from_unit(unit)
    assert points.shape == (5, 12)
    np.testing.assert_allclose(bounds.to_unit(points), unit, atol=1e-12)
    assert bounds.from_unit(np.zeros(12)).tolist() == PAPER["lower"]
    assert bounds.from_unit(np.ones(12)).tolist() == PAPER["upper"]


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"r0_rep": [51.0, 30.8]}, "r0_rep: lower 51.*upper 30.8"),
        ({"r0_rep": [40.0, 40.0]}, "r0_rep: lower 40.*upper 40"),
        ({"r0_rep": [30.0, float("nan")]}, "r0_rep"),
        ({"r0_rep": [30.0, float("inf")]}, "r0_rep"),
        ({"r0_rep": [30.0]}, "pair of finite numbers"),
        ({"r0_rep": "wide"}, "pair of finite numbers"),
        ({"r0_repp": [30.0, 40.0]}, "did you mean r0_rep"),
        ({"p_frict": [-1.0, 2.0]}, "p_frict: -1.0.*over 0"),
        ([1, 2], "table of pairs"),
    ],
)
def test_bounds_that_are_none_are_refused_in_one_line(table, words):
    with pytest.raises(SearchError, match=words) as refusal:
        bounds_of(table)
    assert "\n" not in str(refusal.value)


def test_eleven_numbers_are_refused():
    with pytest.raises(SearchError, match="11 parameters"):
        ParameterBounds(lower=tuple(range(11)), upper=tuple(range(1, 13)))


def test_files_are_read_and_what_they_leave_out_is_the_papers(tmp_path):
    toml, text = tmp_path / "b.toml", tmp_path / "b.json"
    toml.write_text("r0_rep = [20, 60]\n")
    text.write_text('{"r0_rep": [20, 60]}')
    assert load_bounds(toml) == load_bounds(text)
    assert load_bounds(toml).lower[0] == 20.0
    assert load_bounds(toml).upper[1:] == policy_bounds().upper[1:]


@pytest.mark.parametrize(
    ("name", "content"), [("a.toml", b"= 3"), ("a.json", b"["), ("a.json", b"\xff\xfe"), ("a.json", b"[" * 100_000)]
)
def test_hostile_files_are_refused_in_one_line(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SearchError, match=name):
        load_bounds(tmp_path / name)


def test_absent_and_foreign_files_are_refused(tmp_path):
    with pytest.raises(SearchError, match="No such file"):
        load_bounds(tmp_path / "none.toml")
    with pytest.raises(SearchError, match=r"must be a \.toml or a \.json"):
        load_bounds(tmp_path / "b.yaml")
