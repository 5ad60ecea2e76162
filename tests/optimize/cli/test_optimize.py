"""The search's verbs as a user meets them, on flocks that are cheap to fly."""

import contextlib
import io
import json
import sqlite3
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import pytest

from moflock_mj.cli.app import main

MOFLOCK = Path(sys.executable).parent / "moflock"
TINY = ("--drones", "4", "--duration", "4")
SMALL = (*TINY, "--budget", "40", "--population", "8", "--workers", "1")


class Done(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


def run(*arguments):
    """The command line in this process, which is sooner ready than a new one."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        patch.setattr(sys, "argv", ["moflock", *map(str, arguments)])
        patch.setenv("COLUMNS", "120")
        with pytest.raises(SystemExit) as end:
            main()
    return Done(end.value.code, out.getvalue(), err.getvalue())


def told(*arguments):
    done = run(*arguments, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def refused(*arguments):
    done = run(*arguments)
    assert done.returncode == 2, done.stdout
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    return lines[0]


def points_of(path):
    with contextlib.closing(sqlite3.connect(path / "archive.sqlite")) as archive:
        try:
            return archive.execute(
                "SELECT number, r0_rep, a_shill, seeds, fitness FROM evaluations ORDER BY 1"
            ).fetchall()
        except sqlite3.OperationalError:  # its table is not there yet
            return []


def rows_so_far(path):
    try:
        return len(points_of(path))
    except sqlite3.OperationalError:
        return 0  # it has only just begun


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    path = tmp_path_factory.mktemp("search") / "run"
    done = run("optimize", *SMALL, "--front-seeds", 3, "--out", path)
    assert done.returncode == 0, done.stderr
    return path, done.stdout


def test_a_search_prints_the_front_on_fresh_seeds(searched):
    path, printed = searched
    for words in ("on 3 fresh seeds", "knee: F_1", f"moflock report {path}"):
        assert words in printed


@pytest.mark.parametrize("verb", ["pca", "optimize", "pick", "report", "target"])
def test_each_verb_has_an_example(verb):
    assert f"Example: moflock {verb}" in run(verb, "--help").stdout


def test_a_search_starts_from_the_front_of_another(searched, tmp_path):
    path, _ = searched
    front = json.loads((path / "front.json").read_text())
    wish = (*TINY, "--budget", 8, "--population", 8, "--front-seeds", 0, "--workers", 1)
    told("optimize", *wish, "--start-from", path, "--start-from", "A", "--out", tmp_path / "next")
    first = [row[1] for row in points_of(tmp_path / "next")]
    starts = json.loads((tmp_path / "next" / "configuration.json").read_text())["start"]
    assert len(starts) >= 2
    assert all(point in front["points"] for point in starts[:-1])
    assert all(any(abs(point[0] - r0_rep) < 1e-9 for r0_rep in first) for point in starts)


def test_a_picked_point_can_be_flown_and_the_front_stays_as_it_was_flown(searched, tmp_path):
    path, _ = searched
    front = (path / "front.json").read_bytes()
    done = run("pick", path, "--knee", "--workers", 1, "--out", tmp_path / "p.json")
    assert done.returncode == 0, done.stderr
    assert (path / "front.json").read_bytes() == front
    provenance = json.loads((tmp_path / "p.json").read_text())["provenance"]
    assert provenance["chosen_as"] == "knee"
    assert provenance["search_flights"] == 40
    flown = run("fly", "--point", tmp_path / "p.json", *TINY, "--dynamics", "point_mass", "--log", "none")
    assert flown.returncode == 0, flown.stderr


def test_weights_choose_the_ends_of_the_front(searched):
    path, _ = searched
    ends = [told("pick", path, "--weights", w, "--workers", 1) for w in ("1,0", "0,1")]
    first, last = (end["provenance"]["objectives"] for end in ends)
    assert first["F_1"]["mean"] >= last["F_1"]["mean"]
    assert first["F_2"]["mean"] <= last["F_2"]["mean"]


def test_a_report_is_one_page(searched, tmp_path):
    path, _ = searched
    page = Path(told("report", path, "--workers", 1, "--out", tmp_path / "r")["page"])
    assert page.parent == tmp_path / "r"
    assert "<img" in page.read_text()


def test_a_killed_search_resumes_to_the_end_of_one_never_killed(searched, tmp_path):
    whole, _ = searched
    path = tmp_path / "killed"
    process = subprocess.Popen([MOFLOCK, "optimize", *SMALL, "--front-seeds", "0", "--out", path])
    while process.poll() is None and rows_so_far(path) < 10:
        time.sleep(0.005)
    process.kill()
    process.wait()
    left = len(points_of(path))
    assert 10 <= left < 40
    resumed = told("optimize", "--resume", path, "--front-seeds", 0, "--workers", 1)
    assert resumed["complete"]
    assert resumed["replayed"] == left
    assert points_of(path) == points_of(whole)


def test_random_points_give_objectives_for_a_search_of_the_same_scenario_only(tmp_path):
    file = tmp_path / "o.json"
    found = told("pca", *TINY, "--points", 12, "--workers", 1, "--out", file)
    assert len(found["objectives"]) >= 2
    assert file.with_suffix(".png").exists()
    went = ("optimize", "--objectives", file, "--budget", 8, "--population", 8, "--front-seeds", 0, "--workers", 1)
    assert told(*went, *TINY, "--out", tmp_path / "run")["objectives"] == list(found["objectives"])
    line = refused(*went, "--drones", 5, "--duration", 4, "--out", tmp_path / "other")
    assert "drones is 4 there: it must be 5" in line
    assert not (tmp_path / "other").exists()


def test_flocks_around_a_target(tmp_path):
    found = told(
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
        (("optimize", "--start-from", "C"), "point C: unknown"),
        (("optimize", "--start-from", "{tmp}"), "configuration.json"),
        (("optimize", "--start-from", "model_optimum"), "start: r0_shill: 0.5 is out of bounds"),
        (("optimize", "--start-from", "A", "--algorithm", "cmaes"), "start: it requires nsga2 or unsga3"),
        (("optimize", "--start-from", "A", "--start-from", "A"), "point A: it is given twice"),
        (("optimize", "--start-from", "A", "--resume", "{run}"), "its own start_from"),
        (("optimize", "--bounds", "{tmp}/none.toml"), "none.toml"),
        (("optimize", "--bounds", "{tmp}/crossed.toml"), "r0_rep: lower 40 must be under upper 35"),
        (("optimize", "--front-seeds", "1"), "front_seeds: 1"),
        (("optimize", "--resume", "{tmp}/none"), "configuration.json"),
        (("optimize", "--resume", "{tmp}/none", "--budget", "9"), "its own budget"),
        (("optimize", "--workers", "0"), "workers: 0"),
        (("optimize", *TINY, "--scheduler", "tcp://127.0.0.1:9"), "tcp://127.0.0.1:9"),
        (("optimize", *TINY, "--out", "/proc/none/run"), "/proc/none/run"),
        (("pca", "--points", "1"), "points: 1"),
        (("pca", "--sampling", "sobol"), "sobol"),
        (("pick", "{tmp}/none"), "none"),
        (("pick", "{run}", "--weights", "1,x"), "weights: '1,x'"),
        (("pick", "{run}", "--seeds", "3", "--weights", "-1,0"), "weights"),
        (("pick", "{run}", "--seeds", "3", "--min-f1", "2"), "F_1: 2"),
        (("pick", "{run}", "--knee", "--min-f1", "2"), "min_f1 and knee"),
        (("report", "{tmp}"), "configuration.json"),
        (("target", "A", "--at", "1,2,3"), "at: '1,2,3'"),
        (("target", "C"), "point C: unknown"),
    ],
)
def test_bad_input_gets_one_line(arguments, words, searched, tmp_path):
    (tmp_path / "crossed.toml").write_text("r0_rep = [40.0, 35.0]\n")
    before = sorted(tmp_path.iterdir())
    line = refused(*(str(argument).format(tmp=tmp_path, run=searched[0]) for argument in arguments))
    assert words in line
    assert sorted(tmp_path.iterdir()) == before
