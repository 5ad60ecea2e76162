"""Named points and JSON files of points."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from moflock_mj import load_point
from moflock_mj.errors import PointError
from moflock_mj.parameters.points import dump_point, point_names

PAPER = json.loads((Path(__file__).parents[2] / "reference" / "paper.json").read_text())


@pytest.mark.parametrize("name", ["A", "B", "model_optimum"])
def test_named_points_are_the_papers(name):
    assert list(load_point(name)) == PAPER["points"][name]["x"]
    assert list(load_point(name)._asdict()) == PAPER["parameters"]
    assert name in point_names()


def test_a_file_there_and_back(tmp_path):
    path = tmp_path / "point.json"
    path.write_text(dump_point(load_point("A")))
    assert load_point(str(path)) == load_point("A")
    path.write_text(json.dumps(load_point("B")._asdict()))
    assert load_point(str(path)) == load_point("B")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("[1, 2]", "must be an object"),
        ('{"params": 3}', "must be an object"),
        ("{}", "r0_rep: missing"),
        ('{"r0_repp": 1}', "r0_repp.*r0_rep"),
        (json.dumps(load_point("A")._asdict() | {"p_rep": "x"}), "p_rep: 'x' is of the wrong type"),
        (json.dumps(load_point("A")._asdict() | {"p_rep": None}), "p_rep: None is of the wrong type"),
        (json.dumps(load_point("A")._asdict() | {"p_rep": float("nan")}), "p_rep: nan is not a finite number"),
        (json.dumps(load_point("A")._asdict() | {"p_rep": 1e300}), "p_rep: 1e\\+300 is out of bounds"),
        (json.dumps(load_point("A")._asdict() | {"p_shill": -1}), "p_shill: -1.*over 0"),
        (" " * (1 << 20) + "{}", "bytes.*at most"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, content, words):
    path = tmp_path / "point.json"
    path.write_text(content)
    with pytest.raises(PointError, match=words) as refusal:
        load_point(str(path))
    assert "\n" not in str(refusal.value)
    assert "point.json" in str(refusal.value)


@pytest.mark.parametrize("name", ["C", "", "absent.json", "/"])
def test_unknown_points_are_refused(name):
    with pytest.raises(PointError):
        load_point(name)
    with pytest.raises(PointError):
        load_point(name)
