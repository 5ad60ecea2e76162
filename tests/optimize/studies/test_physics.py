"""The study of searches on bodies, end to end, on a flock that is cheap to fly."""

import dataclasses

import numpy as np
import pytest

from moflock_mj.errors import SearchError
from moflock_mj.parameters.points import load_point
from moflock_mj.scenario.scenario import Scenario
from optimize.evaluation.objectives import PAPER
from optimize.search.front import ReevaluatedFront, load_front
from optimize.search.run_directory import RunDirectory
from optimize.studies.physics import Effort, make_study
from optimize.studies.physics_page import KINDS, PLAIN, REFINED, difference
from optimize.validation.validation import ValidationDirectory

TINY = Scenario(drones=3, arena_side=120.0, duration=5.0)
EFFORT = Effort(flights=12, runs=1, points=2, seeds=3, population=8, judged=3, trials=2)


def front_of(fitness, points=None):
    """A front of given fitnesses (n, S, 6)."""
    return ReevaluatedFront(
        objectives=PAPER,
        scenario=TINY,
        dynamics="point_mass",
        policy="vasarhelyi",
        seeds=tuple(range(1, fitness.shape[1] + 1)),
        points=np.zeros((len(fitness), 12)) if points is None else points,
        fitness=fitness,
        failed=np.zeros(len(fitness), np.int64),
        origin={},
    )


def found_there():
    """Three points found on point masses, none of which dominates another."""
    fitness = np.ones((3, 4, 6))
    fitness[:, :, 1] = [[0.9], [0.8], [0.6]]
    fitness[:, :, 2] = [[0.5], [0.8], [0.9]]
    return front_of(fitness, np.array([load_point(name) for name in ("fast", "knee", "cohesive")]))


@pytest.mark.slow
def test_the_study_searches_in_three_ways_and_flies_nothing_twice(tmp_path):
    (tmp_path / "there.json").write_text(found_there().to_json())
    asked = {"docs": tmp_path / "docs", "named": tmp_path / "named", "effort": EFFORT, "workers": 1}
    (tmp_path / "named").mkdir()
    page = make_study(TINY, tmp_path / "there.json", tmp_path / "logs", **asked)
    text = page.read_text()
    assert (tmp_path / "docs" / "physics" / "fronts.png").stat().st_size > 10_000
    assert "is the named point `steady`" in text
    point = load_point(str(tmp_path / "named" / "steady.json"))
    assert point in ValidationDirectory.open(tmp_path / "logs" / "judged").settings.points.values()
    seeds = {load_front(path).seeds for path in (tmp_path / "logs").glob("*/front.json")}
    assert len(seeds) == 1, "the fronts were not flown on the same seeds"
    for kind in KINDS:
        with RunDirectory.open(tmp_path / "logs" / f"{kind}-1") as run:
            assert sum(len(flown.seeds) for flown in run.evaluations()) == EFFORT.flights
            assert (run.screening is None) == (kind == PLAIN)
            assert len(run.configuration.start) == (2 if kind == REFINED else 0)
            assert run.configuration.scenario.point_mass is not None

    archives = {path: path.stat().st_mtime_ns for path in (tmp_path / "logs").glob("*/*.sqlite")}
    assert len(archives) == 6
    make_study(TINY, tmp_path / "there.json", tmp_path / "logs", **asked)
    assert page.read_text() == text
    assert archives == {path: path.stat().st_mtime_ns for path in archives}, "something was flown again"

    with pytest.raises(SearchError, match="plain-1: it is of another search"):
        make_study(TINY, tmp_path / "there.json", tmp_path / "logs", **asked | {"effort": EFFORT._replace(flights=13)})
    other = dataclasses.replace(TINY, drones=4)
    with pytest.raises(SearchError, match="it is of another scenario"):
        make_study(other, tmp_path / "there.json", tmp_path / "logs", **asked)


def test_a_difference_of_hypervolumes_knows_that_seeds_are_common():
    """One point each, so that the hypervolume is F_1 F_2: a luckier seed is luckier for both fronts."""
    luck = np.array([0.0, 0.1, 0.2, 0.1])
    better, worse = np.ones((1, 4, 6)), np.ones((1, 4, 6))
    better[0, :, 1], worse[0, :, 1] = 0.6 + luck, 0.5 + luck
    found = difference([front_of(better)], [front_of(worse)])
    assert found.mean == pytest.approx(0.1)
    assert found.half_width == pytest.approx(0.0, abs=1e-9)
