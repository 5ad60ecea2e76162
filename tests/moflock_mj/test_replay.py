"""`moflock replay` as a user meets it."""

from __future__ import annotations

import json

import pytest

from moflock_mj import Scenario, fly, paper_point
from tests.moflock_mj.test_cli import run

SCENARIO = Scenario(drones=4, duration=12.0, arena_side=100.0)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "flight.mcap"
    fly(paper_point("A"), scenario=SCENARIO, dynamics="point_mass", log=path, keep_samples=False)
    return path


def test_a_log_tells_its_figures(log):
    done = run("replay", log)
    assert done.returncode == 0, done.stderr
    assert "phi_cluster" in done.stdout
    told = json.loads(run("replay", log, "--json").stdout)
    assert (told["drones"], told["flown"]) == (4, 12.0)


def test_a_log_is_verified(log):
    done = run("replay", log, "--verify")
    assert done.returncode == 0, done.stderr
    assert "bit-identical" in done.stdout


def test_a_log_is_flown_on_with_another_point(log, tmp_path):
    done = run("replay", log, "--resume", "11", "--point", "B", "--log", "b.mcap", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["complete"]
    assert (tmp_path / "b.mcap").exists()


def test_a_broken_log_is_recovered(log, tmp_path):
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(log.read_bytes()[:-2000])
    refused = run("replay", broken)
    assert refused.returncode == 2
    assert "--recover" in refused.stderr
    done = run("replay", broken, "--recover", "--log", tmp_path / "mended.mcap")
    assert done.returncode == 0, done.stderr
    assert run("replay", tmp_path / "mended.mcap").returncode == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("absent.mcap",), "absent.mcap"),
        (("LOG", "LOG", "LOG"), "3 logs"),
        (("LOG", "LOG", "--verify"), "--verify of 2 logs"),
        (("LOG", "--verify", "--recover"), "do not go together"),
        (("LOG", "--resume", "-1"), "-1"),
        (("LOG", "--size", "big", "--video", "x.mp4"), "size: 'big'"),
        (("LOG", "--picture", "/proc/none/x.png"), "/proc/none"),
        (("LOG", "LOG", "--csv", "x.csv"), "csv: 2 logs"),
        (("LOG", "--camera", "side"), "side"),
    ],
)
def test_bad_input_is_one_line_and_status_2(log, tmp_path, arguments, words):
    done = run("replay", *(log if word == "LOG" else word for word in arguments), cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
