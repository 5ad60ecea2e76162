"""Validation as a user meets it, on flocks that are cheap to fly."""

import json

import numpy as np
import pytest

from moflock_mj.errors import SearchError
from moflock_mj.parameters.points import dump_point, load_point
from moflock_mj.scenario.scenario import Scenario
from optimize.evaluation.evaluation import FIGURE_NAMES, EvaluationTask, Job, infeasible
from optimize.studies.validation import POINTS, make_study
from optimize.validation.fault_trials import fault_trials, standard_faults
from optimize.validation.validation import ValidationConfig, ValidationDirectory, gather
from tests.support.cli import refused, run, start_program
from tests.support.search import evaluations_in, rows_of
from tests.support.waiting import wait_until

TINY = ("--drones", "4", "--duration", "4", "--workers", "1")
COLUMNS = "number, generation, r0_rep, seeds, fitness, figures"


@pytest.fixture(scope="module")
def validated(tmp_path_factory):
    path = tmp_path_factory.mktemp("validate") / "run"
    point = path.parent / "mine.json"
    point.write_text(dump_point(load_point("B")._replace(v_frict=1.0)))
    done = run("validate", "A", point, "--seeds", 2, "--fault-seeds", 1, *TINY, "--out", path)
    assert done.returncode == 0, done.stderr
    return path, done.stdout


@pytest.mark.slow
def test_all_that_was_promised_is_there(validated):
    path, printed = validated
    for words in (
        "Objectives and verdicts",
        "All fitnesses",
        "Rigid bodies",
        "Fronts",
        "power_off",
        "mine: flyable",
    ):
        assert words in printed
    assert (path / "fronts.png").stat().st_size > 10_000
    assert "| mine |" in (path / "validation.md").read_text()
    for log in (path / "logs").iterdir():
        assert run("replay", log).returncode == 0


@pytest.mark.slow
def test_the_numbers_are_those_of_the_flights(validated):
    path, _ = validated
    told = json.loads((path / "validation.json").read_text())
    assert [point["name"] for point in told["points"]] == ["A", "mine"]
    first = told["points"][0]
    flights = [
        json.loads(run("fly", "--point", "A", *TINY[:4], "--seed", seed, "--log", "none", "--json").stdout)
        for seed in told["seeds"]
    ]
    assert first["rigid_body"]["F_1"]["mean"] == pytest.approx(np.mean([f["fitness"]["F_1"] for f in flights]))
    for name in ("tilt_max", "energy", "touched"):
        assert first["rigid_body"]["figures_of_each_flight"][name] == [f["body"][name] for f in flights]
    assert list(told["faults"]) == list(standard_faults(Scenario()))
    assert {trial["points"][name]["flights"] for trial in told["faults"].values() for name in ("A", "mine")} == {1}
    gap = first["rigid_body"]["F_1"]["mean"] - first["point_mass"]["F_1"]["mean"]
    assert first["gap"]["F_1"]["mean"] == pytest.approx(gap)


@pytest.mark.slow
def test_a_killed_validation_resumes_to_the_numbers_of_one_never_killed(validated, tmp_path):
    whole, _ = validated
    path = tmp_path / "killed"
    point = whole.parent / "mine.json"
    wish = ("--seeds", 2, "--fault-seeds", 1, *TINY, "--out", path, "--no-logs")
    process = start_program("validate", "A", point, *wish)
    wait_until(lambda: process.poll() is not None or evaluations_in(path) >= 2, pause=0.005)
    process.kill()
    process.communicate()
    assert evaluations_in(path) >= 2
    done = run("validate", "--resume", path, "--workers", 1, "--no-logs")
    assert done.returncode == 0, done.stderr
    assert rows_of(path, COLUMNS) == rows_of(whole, COLUMNS)
    ours, theirs = (json.loads((folder / "validation.json").read_text()) for folder in (path, whole))
    for point in (*ours["points"], *theirs["points"]):
        point.pop("log")
    assert ours == theirs


@pytest.mark.slow
def test_a_directory_comes_back(validated):
    path, _ = validated
    with ValidationDirectory.open(path) as directory:
        settings = directory.settings
        assert ValidationConfig.from_texts(settings.to_json(), settings.scenario.to_toml()) == settings
        found = gather(directory)
    assert found.fitness.shape == (2, 2, 2, 6)
    assert np.isnan(found.column("energy", 0)).all()
    assert (found.column("energy") > 0).all()


def test_what_a_fault_brings_down_by_itself_is_not_lost_to_others():
    """One drone lost: the one that was switched off, but by a blackout an innocent one."""
    scenario = Scenario(drones=5)
    faults = {name: standard_faults(scenario)[name] for name in ("power_off", "cannot_receive")}
    job, task = Job(scenario=scenario, dynamics="rigid_body"), EvaluationTask(0, load_point("A"), (1,))
    one, three, failed = (infeasible(job, task, "as for a test") for _ in range(3))
    for flown, lost in ((one, 1), (three, 3)):
        flown.figures[0] = 0.0
        flown.figures[0, FIGURE_NAMES.index("lost")] = lost
    power_off, cannot_receive = fault_trials(faults, [one, three, failed] * 2, points=1, seeds=3)
    assert power_off.lost.tolist() == [[0, 2, 4]]
    assert cannot_receive.lost.tolist() == [[1, 3, 5]]
    assert (power_off.survived.tolist(), cannot_receive.survived.tolist()) == ([1], [0])
    assert [trial.verdict for trial in (power_off, cannot_receive)] == ["not survived"] * 2
    (alone,) = fault_trials({"power_off": faults["power_off"]}, [one], points=1, seeds=1)
    assert alone.verdict == "unharmed"


@pytest.mark.slow
def test_the_study_makes_its_page_and_is_not_flown_twice(tmp_path):
    scenario = Scenario(drones=3, duration=1.0)
    effort = {"seeds": 2, "fault_seeds": 1, "workers": 1}
    for _ in range(2):
        page = make_study(scenario, tmp_path / "logs", tmp_path / "docs", **effort)
        text = page.read_text()
        assert "Velocity error" in text
        assert "power_off" in text
        assert (tmp_path / "docs" / "validation" / "fronts.png").exists()
    flights = 2 * 2 + len(standard_faults(scenario))
    assert evaluations_in(tmp_path / "logs") == flights * len(POINTS)
    with pytest.raises(SearchError, match="of another scenario, other points or seeds"):
        make_study(scenario, tmp_path / "logs", tmp_path / "docs", **effort | {"fault_seeds": 2})


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("validate",), "points: there are none"),
        (("validate", "C"), "point C"),
        (("validate", "A", "A"), "point A"),
        (("validate", "A", "--seeds", 2, "--fault-seeds", 3), "fault_seeds: 3"),
        (("validate", "{tmp}/none.json"), "none.json"),
        (("validate", "{tmp}/none"), "a search directory"),
        (("validate", "{tmp}"), "configuration.json"),
        (("validate", "A", "--seeds", "0"), "seeds: 0"),
        (("validate", "A", "--seeds", "1"), "seeds: 1"),
        (("validate", "A", "--scenario", "{tmp}/weak.toml"), "a_max: 30 m/s^2"),
        (("validate", "A", "--scenario", "{tmp}/boat.toml"), "airframe: 'boat'"),
        (("validate", "A", "--scenario", "{tmp}/limit.toml"), "verdict.saturated: 2.0"),
        (("validate", "A", "--workers", "0"), "workers: 0"),
        (("validate", "--resume", "{tmp}/none"), "configuration.json"),
        (("validate", "A", "--resume", "{tmp}/none"), "its own points"),
        (("identify", "boat"), "airframe: 'boat'"),
        (("identify", "x500", "--scenario", "{tmp}/weak.toml"), "a_max: 30"),
    ],
)
def test_bad_input_gets_one_line(arguments, words, tmp_path):
    (tmp_path / "weak.toml").write_text("a_max = 30.0\n")
    (tmp_path / "boat.toml").write_text('airframe = "boat"\n')
    (tmp_path / "limit.toml").write_text("[verdict]\nsaturated = 2.0\n")
    before = sorted(tmp_path.iterdir())
    extra = ("--out", "{tmp}/out") if arguments[0] == "validate" and "--resume" not in arguments else ()
    line = refused(*(str(argument).format(tmp=tmp_path) for argument in (*arguments, *extra)))
    assert words in line
    assert sorted(tmp_path.iterdir()) == before
