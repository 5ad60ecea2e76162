"""Studies whose flights are kept: stopped anywhere and run again they end the same, and fly nothing twice."""

import json
import os
import signal

import pytest

from controllers.policies.vasarhelyi import VASARHELYI
from moflock_mj.parameters.points import load_point
from moflock_mj.scenario.scenario import Scenario
from optimize.evaluation import resumable
from optimize.evaluation.archive import Archive
from optimize.evaluation.evaluation import EvaluationTask, Job
from optimize.evaluation.resumable import ResumableEvaluator
from tests.support.cli import refused, run, start_program
from tests.support.search import FakeExecutor, change_archive, evaluations_in
from tests.support.waiting import wait_until

TINY = ("--duration", 2, "--workers", 1, "--json")
LONG = ("--duration", 1000)
"""Flights of some milliseconds each, so that a busy machine has not flown them all before it is stopped."""
SENSITIVITY = ("sensitivity", "A", "--samples", 2, "--levels", 2, "--seeds", 2, "--drones", 4, *TINY)
SWEEP = ("sweep", "A", "--drones", "2,3", "--t-del", "0,0.5", "--seeds", 3, *TINY)
PCA = ("pca", "--points", 20, "--drones", 4, *TINY)
FLIGHTS = {SENSITIVITY: 2 * 14 + 12 * 2 * 2, SWEEP: 4 * 3, PCA: 20}


class Mortal(FakeExecutor):
    """Dies, as by Ctrl-C, instead of the flight after so many."""

    def __init__(self, job, dies_after=None):
        super().__init__(job)
        self.dies_after = dies_after
        self.flights = []

    def evaluate(self, tasks):
        variants = {task.number: task.variant for task in tasks}
        for evaluation in super().evaluate(tasks):
            if len(self.flights) == self.dies_after:
                raise KeyboardInterrupt
            self.flights.append((evaluation.params, evaluation.seeds, variants[evaluation.number]))
            yield evaluation


def studied(arguments, out, dies_after=None):
    """The command on flights that cost nothing: how it ended, and what it flew."""
    crews = []

    def make_executor(job, workers, scheduler):  # noqa: ARG001
        crews.append(Mortal(job, dies_after))
        return crews[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(resumable, "make_executor", make_executor)
        done = run(*arguments, "--out", out)
    return done, [flight for crew in crews for flight in crew.flights]


def contents(path):
    return {file.name: file.read_bytes() for file in path.iterdir()}


@pytest.mark.parametrize(
    "arguments",
    [pytest.param(SENSITIVITY, marks=pytest.mark.slow), SWEEP, PCA],
    ids=lambda arguments: arguments[0],
)
def test_interrupted_anywhere_and_run_again_it_ends_the_same(arguments, tmp_path):
    count = FLIGHTS[arguments]
    whole, expected = studied(arguments, tmp_path / "whole.json")
    assert (whole.returncode, whole.stderr, len(expected)) == (0, "", count)
    out, flown = tmp_path / "cut.json", []
    for dies_after in (0, 1, count // 2, count - count // 2 - 2):
        cut, flights = studied(arguments, out, dies_after)
        assert (cut.returncode, cut.stdout, len(flights)) == (130, "", dies_after)
        assert cut.stderr.splitlines()[-1].startswith("stopped; go on with the same command")
        flown += flights
    last, flights = studied(arguments, out)
    assert (last.returncode, last.stdout) == (0, whole.stdout)
    assert last.stderr.startswith(f"{count - 1} flights are in ")
    assert len(flights) == 1
    assert flown + flights == expected


def test_a_study_that_is_over_is_not_flown_again(tmp_path):
    first, _ = studied(PCA, tmp_path / "o.json")
    made = contents(tmp_path / "o.flights")
    again, flights = studied(PCA, tmp_path / "o.json")
    assert (again.stdout, flights) == (first.stdout, [])
    assert contents(tmp_path / "o.flights") == made


def test_without_a_folder_each_study_has_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(resumable, "make_executor", lambda job, *_: FakeExecutor(job))
    for arguments in (SWEEP, PCA, SWEEP, (*SWEEP, "--seeds", 2)):
        assert run(*arguments).returncode == 0
    assert sorted(path.name.split("-")[0] for path in (tmp_path / "logs").iterdir()) == ["pca", "sweep", "sweep"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("--points", 21), "points"),
        (("--seed", 2), "seed"),
        (("--sampling", "latin_hypercube"), "sampling"),
        (("--dynamics", "rigid_body"), "dynamics, scenario"),  # whose step is another
        (("--drones", 5), "scenario"),
        (("--bounds", "bounds.toml"), "bounds"),
    ],
)
def test_flights_of_another_study_are_refused(change, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bounds.toml").write_text("r0_rep = [20.0, 30.0]\n")
    studied(PCA, "o.json", dies_after=5)
    before = contents(tmp_path / "o.flights")
    assert f"the flights of another study ({words})" in refused(*PCA, *change, "--out", "o.json")
    assert contents(tmp_path / "o.flights") == before
    assert not (tmp_path / "o.json").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("sensitivity", "B", *SENSITIVITY[2:]), "(point)"),
        ((*SENSITIVITY, "--samples", 4), "(samples)"),
        ((*SENSITIVITY, "--levels", 3), "(levels)"),
        ((*SENSITIVITY, "--seeds", 3), "(seeds)"),
        (SWEEP, "study"),
    ],
)
def test_a_folder_of_another_sensitivity_is_refused(arguments, words, tmp_path):
    studied(SENSITIVITY, tmp_path / "s", dies_after=5)
    assert words in refused(*arguments, "--out", tmp_path / "s")


def test_flights_of_other_versions_are_refused(tmp_path, monkeypatch):
    studied(SWEEP, tmp_path / "s", dies_after=5)
    monkeypatch.setattr(resumable, "installed_versions", lambda _: {"mujoco": "2"})
    assert "another study (versions)" in refused(*SWEEP, "--out", tmp_path / "s")


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "notes.txt").write_text("mine")
    assert "it is not empty" in refused(*SWEEP, "--out", tmp_path / "s")
    assert contents(tmp_path / "s") == {"notes.txt": b"mine"}
    (tmp_path / "s" / "configuration.json").write_text("{")
    (tmp_path / "s" / "scenario.toml").write_text("")
    assert "not JSON" in refused(*SWEEP, "--out", tmp_path / "s")


def test_what_failed_or_is_damaged_is_flown_again(tmp_path):
    job = Job(scenario=Scenario(), dynamics="point_mass")
    tasks = [EvaluationTask(number, load_point("A"), (number,)) for number in range(6)]
    with Archive(tmp_path, VASARHELYI) as archive:
        first = list(ResumableEvaluator(FakeExecutor(job, fails=[2]), archive).evaluate(tasks))
    assert [flown.number for flown in first if flown.outcome != "ok"] == [2]
    change_archive(tmp_path, "UPDATE evaluations SET r0_rep = 31.0 WHERE number = 4")
    with Archive(tmp_path, VASARHELYI) as archive:
        executor = FakeExecutor(job)
        again = list(ResumableEvaluator(executor, archive).evaluate(tasks))
    assert executor.flown == [2, 4]
    assert sorted(flown.number for flown in again) == list(range(6))


@pytest.mark.slow
def test_ctrl_c_keeps_what_was_flown(tmp_path):
    """On flights that are real, as from a terminal, whose whole group of processes gets the signal."""
    arguments = [str(part) for part in ("sweep", "A", "--drones", "9,10", "--seeds", 150, *TINY, *LONG, "--out")]
    process = start_program(*arguments, tmp_path / "cut", start_new_session=True)
    wait_until(lambda: process.poll() is not None or evaluations_in(tmp_path / "cut") >= 5, pause=0.005)
    os.killpg(process.pid, signal.SIGINT)
    printed, line = process.communicate()
    assert (process.returncode, printed) == (130, "")
    assert line == f"stopped; go on with the same command: its flights are kept in {tmp_path / 'cut'}\n"
    left = evaluations_in(tmp_path / "cut")
    assert 5 <= left < 300
    resumed = run(*arguments, tmp_path / "cut")
    assert resumed.stderr.startswith(f"{left} flights are in ")
    assert evaluations_in(tmp_path / "cut") == 300
    assert resumed.stdout == run(*arguments, tmp_path / "whole").stdout
    assert len(json.loads(resumed.stdout)["sweeps"]["drones"]["fitness"]) == 2
