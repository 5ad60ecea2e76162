"""The paper's study, end to end, on a flock that is cheap to fly."""

import dataclasses

import numpy as np
import pytest

from moflock_mj.parameters.points import load_point
from moflock_mj.scenario.scenario import Scenario
from optimize.evaluation.objectives import PAPER
from optimize.search.front import ReevaluatedFront
from optimize.studies.comparison import COMPETITORS, score
from optimize.studies.paper import Effort, reproduce

TINY = Scenario(drones=4, arena_side=150.0, duration=110.0)
EFFORT = Effort(points=12, analyses=1, budget=60, runs=1, fresh=2, seeds=3, tracks=1)


@pytest.mark.slow
def test_the_study_writes_its_page_its_figures_and_the_named_points(tmp_path):
    asked = {"docs": tmp_path / "docs", "named": tmp_path / "named", "workers": 1, "effort": EFFORT}
    (tmp_path / "docs").mkdir()
    (tmp_path / "named").mkdir()
    page = reproduce(TINY, tmp_path / "logs", **asked)
    text = page.read_text()
    for name in COMPETITORS:
        assert f"| {name} |" in text
    pictures = [line.split("(")[1].rstrip(")") for line in text.splitlines() if line.startswith("![")]
    assert len(pictures) == 6
    for picture in pictures:
        assert (tmp_path / "docs" / picture).stat().st_size > 10_000
    for name in ("fast", "knee", "cohesive"):
        load_point(str(tmp_path / "named" / f"{name}.json"))

    archives = {path: path.stat().st_mtime_ns for path in (tmp_path / "logs").glob("*/archive.sqlite")}
    assert len(archives) == len(COMPETITORS) + 2
    reproduce(TINY, tmp_path / "logs", **asked)
    assert page.read_text() == text
    assert archives == {path: path.stat().st_mtime_ns for path in archives}, "something was flown again"


def test_runs_are_scored_on_the_same_number_of_seeds():
    fitness = np.ones((2, 3, 6))
    fitness[0, :, 0], fitness[1, :, 2] = (0.2, 0.4, 0.9), (0.5, 0.5, 1.0)
    front = ReevaluatedFront(
        objectives=PAPER,
        scenario=TINY,
        dynamics="point_mass",
        policy="vasarhelyi",
        seeds=(1, 2, 3),
        points=np.zeros((2, 12)),
        fitness=fitness,
        failed=np.zeros(2, np.int64),
        origin={},
    )
    found = score([front, dataclasses.replace(front, points=front.points + 1)], 2)
    # Means over two seeds: (0.3, 1) and (1, 0.5).
    assert found.hypervolume == pytest.approx([0.3 + 0.7 * 0.5] * 2)
    assert found.product == pytest.approx([0.5, 0.5])
    np.testing.assert_allclose(found.best, [[1, 1], [1, 1]])
