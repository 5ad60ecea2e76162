"""The commands of a search as a user meets them, on flocks that are cheap to fly."""

import json
from pathlib import Path

import pytest

from tests.support.cli import json_of, refused, run, start_program
from tests.support.search import SMALL, TINY, evaluations_in, points_of
from tests.support.waiting import wait_until


def test_a_search_prints_the_front_on_fresh_seeds(searched_run):
    path, printed = searched_run
    for words in ("on 3 fresh seeds", "knee: F_1", f"moflock report {path}"):
        assert words in printed


def test_a_search_starts_from_the_front_of_another(searched_run, tmp_path):
    path, _ = searched_run
    front = json.loads((path / "front.json").read_text())
    wish = (*TINY, "--budget", 8, "--population", 8, "--front-seeds", 0, "--workers", 1)
    json_of("optimize", *wish, "--start-from", path, "--start-from", "A", "--out", tmp_path / "next")
    first = [row[1] for row in points_of(tmp_path / "next")]
    starts = json.loads((tmp_path / "next" / "configuration.json").read_text())["start"]
    assert len(starts) >= 2
    assert all(point in front["points"] for point in starts[:-1])
    assert all(any(abs(point[0] - r0_rep) < 1e-9 for r0_rep in first) for point in starts)


@pytest.mark.slow
def test_a_picked_point_can_be_flown_and_the_front_stays_as_it_was_flown(searched_run, tmp_path):
    path, _ = searched_run
    front = (path / "front.json").read_bytes()
    done = run("pick", path, "--knee", "--workers", 1, "--out", tmp_path / "p.json")
    assert done.returncode == 0, done.stderr
    assert (path / "front.json").read_bytes() == front
    provenance = json.loads((tmp_path / "p.json").read_text())["provenance"]
    assert provenance["chosen_as"] == "knee"
    assert provenance["search_flights"] == 40
    flown = run("fly", "--point", tmp_path / "p.json", *TINY, "--dynamics", "point_mass", "--log", "none")
    assert flown.returncode == 0, flown.stderr


@pytest.mark.slow
def test_weights_choose_the_ends_of_the_front(searched_run):
    path, _ = searched_run
    ends = [json_of("pick", path, "--weights", w, "--workers", 1) for w in ("1,0", "0,1")]
    first, last = (end["provenance"]["objectives"] for end in ends)
    assert first["F_1"]["mean"] >= last["F_1"]["mean"]
    assert first["F_2"]["mean"] <= last["F_2"]["mean"]


@pytest.mark.slow
def test_a_report_is_one_page(searched_run, tmp_path):
    path, _ = searched_run
    page = Path(json_of("report", path, "--workers", 1, "--out", tmp_path / "r")["page"])
    assert page.parent == tmp_path / "r"
    assert "<img" in page.read_text()


@pytest.mark.slow
def test_a_killed_search_resumes_to_the_end_of_one_never_killed(searched_run, tmp_path):
    whole, _ = searched_run
    path = tmp_path / "killed"
    process = start_program("optimize", *SMALL, "--front-seeds", "0", "--out", path)
    wait_until(lambda: process.poll() is not None or evaluations_in(path) >= 10, pause=0.005)
    process.kill()
    process.communicate()
    left = len(points_of(path))
    assert 10 <= left < 40
    resumed = json_of("optimize", "--resume", path, "--front-seeds", 0, "--workers", 1)
    assert resumed["complete"]
    assert resumed["replayed"] == left
    assert points_of(path) == points_of(whole)


@pytest.mark.slow
def test_random_points_give_objectives_for_a_search_of_the_same_scenario_only(tmp_path):
    file = tmp_path / "o.json"
    found = json_of("pca", *TINY, "--points", 12, "--workers", 1, "--out", file)
    assert len(found["objectives"]) >= 2
    assert file.with_suffix(".png").exists()
    went = ("optimize", "--objectives", file, "--budget", 8, "--population", 8, "--front-seeds", 0, "--workers", 1)
    assert json_of(*went, *TINY, "--out", tmp_path / "run")["objectives"] == list(found["objectives"])
    line = refused(*went, "--drones", 5, "--duration", 4, "--out", tmp_path / "other")
    assert "drones is 4 there: it must be 5" in line
    assert not (tmp_path / "other").exists()


def test_flocks_around_a_target(tmp_path):
    found = json_of(
        "target", "A", "B", "--at", "100,50", "--drones", 4, "--duration", 150, "--picture", tmp_path / "t.png"
    )
    assert [flock["point"] for flock in found["flocks"]] == ["A", "B"]
    assert found["target"] == [100, 50]
    assert (tmp_path / "t.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("optimize", "--budget", "0"), "budget"),
        (("optimize", "--drones", "0"), "drones"),
        (("optimize", "--seeds", "1000", "--budget", "100"), "budget: 100 flights"),
        (("optimize", "--unbounded"), "unbounded: only cmaes"),
        (("optimize", "--screen"), "screen: it is for the dynamics rigid_body"),
        (("optimize", "--screen", "--dynamics", "rigid_body", "--algorithm", "cmaes"), "screen: it requires nsga2"),
        (("optimize", "--start-from", "C"), "point C"),
        (("optimize", "--start-from", "{tmp}"), "configuration.json"),
        (("optimize", "--start-from", "model_optimum"), "start: r0_shill: 0.5"),
        (("optimize", "--start-from", "A", "--algorithm", "cmaes"), "start: it requires nsga2 or unsga3"),
        (("optimize", "--start-from", "A", "--start-from", "A"), "point A"),
        (("optimize", "--start-from", "A", "--resume", "{run}"), "its own start_from"),
        (("optimize", "--bounds", "{tmp}/none.toml"), "none.toml"),
        (("optimize", "--bounds", "{tmp}/crossed.toml"), "r0_rep: lower 40"),
        (("optimize", "--front-seeds", "1"), "front_seeds: 1"),
        (("optimize", "--resume", "{tmp}/none"), "configuration.json"),
        (("optimize", "--resume", "{tmp}/none", "--budget", "9"), "its own budget"),
        (("optimize", "--workers", "0"), "workers: 0"),
        pytest.param(
            ("optimize", *TINY, "--scheduler", "tcp://127.0.0.1:9"), "tcp://127.0.0.1:9", marks=pytest.mark.slow
        ),
        (("optimize", *TINY, "--out", "/proc/none/run"), "/proc/none/run"),
        (("pca", "--points", "1"), "points: 1"),
        (("pca", "--sampling", "sobol"), "sobol"),
        (("pick", "{tmp}/none"), "none"),
        (("pick", "{run}", "--weights", "1,x"), "weights: '1,x'"),
        pytest.param(("pick", "{run}", "--seeds", "3", "--weights", "-1,0"), "weights", marks=pytest.mark.slow),
        pytest.param(("pick", "{run}", "--seeds", "3", "--min-f1", "2"), "F_1: 2", marks=pytest.mark.slow),
        (("pick", "{run}", "--knee", "--min-f1", "2"), "min_f1 and knee"),
        (("report", "{tmp}"), "configuration.json"),
        (("target", "A", "--at", "1,2,3"), "at: '1,2,3'"),
        (("target", "C"), "point C"),
    ],
)
def test_bad_input_gets_one_line(arguments, words, searched_run, tmp_path):
    (tmp_path / "crossed.toml").write_text("r0_rep = [40.0, 35.0]\n")
    before = sorted(tmp_path.iterdir())
    line = refused(*(str(argument).format(tmp=tmp_path, run=searched_run[0]) for argument in arguments))
    assert words in line
    assert sorted(tmp_path.iterdir()) == before
