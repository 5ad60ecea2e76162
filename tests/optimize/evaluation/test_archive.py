"""The run directory: what is stored comes back, and survives kills, damage and full disks."""

import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from moflock_mj.errors import SearchError
from moflock_mj.parameters.bounds import bounds_of
from moflock_mj.parameters.points import load_point
from optimize.evaluation.evaluation import EvaluationTask, Job, infeasible
from optimize.search.configuration import Configuration, SearchConfig
from optimize.search.run_directory import RunDirectory
from tests.support.search import change_archive, small_configuration, some_evaluation


def same(one, two):
    blank = dict.fromkeys(("order_parameters", "fitness", "figures"), 0)
    return one._replace(**blank) == two._replace(**blank) and all(
        np.array_equal(getattr(one, name), getattr(two, name), equal_nan=True) for name in blank
    )


def filled(path, count=40):
    run = RunDirectory.create(path, small_configuration())
    for number in reversed(range(count)):
        run.append(some_evaluation(number), number // 8)
    return run


def test_evaluations_come_back_bit_by_bit_in_the_order_of_their_numbers(tmp_path):
    filled(tmp_path / "run").close()
    with RunDirectory.open(tmp_path / "run") as run:
        found = run.evaluations()
        assert [evaluation.number for evaluation in found] == list(range(40))
        assert all(same(evaluation, some_evaluation(evaluation.number)) for evaluation in found)
        assert [evaluation.number for evaluation in run.evaluations(generation=1)] == list(range(8, 16))
        assert run.damaged == 0


def test_an_infeasible_evaluation_comes_back(tmp_path):
    configuration = small_configuration()
    job = Job(scenario=configuration.scenario, dynamics="point_mass")
    failed = infeasible(job, EvaluationTask(0, load_point("A"), (1, 2)), "it\nwould not")
    with RunDirectory.create(tmp_path / "run", configuration) as run:
        run.append(failed, 0)
        assert same(run.evaluations()[0], failed)
    assert failed.outcome == "it would not"
    assert not failed.fitness.any()


def test_the_configuration_comes_back(tmp_path):
    configuration = Configuration(
        bounds=bounds_of({"r0_rep": [20.1, 60.3]}),
        settings=SearchConfig(algorithm="nsga2", seeds=3, timeout=None),
        start=(load_point("A"), load_point("B")._replace(r0_rep=20.1)),
    )
    RunDirectory.create(tmp_path / "run", configuration).close()
    with RunDirectory.open(tmp_path / "run") as run:
        assert run.configuration == configuration


def test_a_directory_that_is_not_empty_is_refused(tmp_path):
    (tmp_path / "mine.txt").write_text("x")
    with pytest.raises(SearchError, match="not empty"):
        RunDirectory.create(tmp_path, small_configuration())
    with pytest.raises(SearchError, match="must hold a configuration"):
        RunDirectory.open(tmp_path)


def test_two_searches_in_one_directory_are_refused(tmp_path):
    run = filled(tmp_path / "run", 1)
    other = RunDirectory.open(tmp_path / "run")
    with run.locked(), pytest.raises(SearchError, match="another command"), other.locked():
        pass
    other.close()
    run.close()


@pytest.mark.slow
def test_rows_outlive_a_killed_program(tmp_path):
    program = textwrap.dedent(
        """
        import sys
        from optimize.search.run_directory import RunDirectory
        from tests.support.search import small_configuration, some_evaluation
        run = RunDirectory.create(sys.argv[1], small_configuration())
        for number in range(10**6):
            run.append(some_evaluation(number), 0)
            print(number, flush=True)
        """
    )
    writer = subprocess.Popen([sys.executable, "-c", program, tmp_path / "run"], stdout=subprocess.PIPE, text=True)
    told = [writer.stdout.readline() for _ in range(50)]
    writer.send_signal(signal.SIGKILL)
    told += writer.communicate()[0].splitlines()
    with RunDirectory.open(tmp_path / "run") as run:
        found = run.evaluations()
    assert len(found) >= len(told) >= 50
    assert all(same(evaluation, some_evaluation(evaluation.number)) for evaluation in found)


def test_a_damaged_last_row_is_left_out_and_repaired(tmp_path):
    filled(tmp_path / "run").close()
    change_archive(tmp_path / "run", "UPDATE evaluations SET fitness = '[[1, 2' WHERE number = 39")
    with RunDirectory.open(tmp_path / "run") as run:
        assert run.damaged == 1
        assert [evaluation.number for evaluation in run.evaluations()] == list(range(39))
        run.repair()
        assert run.damaged == 0
        assert len(run.evaluations()) == 39
    assert (tmp_path / "run" / "archive.damaged").exists()


@pytest.mark.parametrize("seed", range(12))
def test_noise_in_the_file_is_survived_or_refused_in_one_line(tmp_path, seed):
    filled(tmp_path / "run").close()
    archive, rng = tmp_path / "run" / "archive.sqlite", np.random.default_rng(seed)
    content = bytearray(archive.read_bytes())
    start = int(rng.integers(0 if seed % 3 == 0 else 4096, len(content) - 600))
    content[start : start + 600] = rng.bytes(600)
    if seed % 4 == 1:
        content = content[: len(content) // 2]
    archive.write_bytes(content)
    try:
        with RunDirectory.open(tmp_path / "run") as run:
            run.repair()
            found = run.evaluations()
            run.append(some_evaluation(1000), 9)
            assert len(run.evaluations()) == len(found) + 1
    except SearchError as refusal:
        line = str(refusal)
        found = []
    else:
        line = "archive.sqlite"
    assert "archive.sqlite" in line
    assert "\n" not in line
    assert all(same(evaluation, some_evaluation(evaluation.number)) for evaluation in found)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("configuration.json", b"{"),
        ("configuration.json", b"[]"),
        ("configuration.json", b"\xff"),
        ("configuration.json", b'{"settings": {"budgett": 3}, "bounds": {}, "objectives": {}, "versions": {}}'),
        ("configuration.json", b'{"settings": {"budget": "x"}, "bounds": {}, "objectives": {}, "versions": {}}'),
        ("scenario.toml", b"drones = -3"),
        ("archive.sqlite", b"not a database, not at all, " * 100),
    ],
)
def test_hostile_files_are_refused_in_one_line(tmp_path, name, content):
    filled(tmp_path / "run", 2).close()
    (tmp_path / "run" / name).write_bytes(content)
    with pytest.raises(SearchError) as refusal:
        RunDirectory.open(tmp_path / "run").close()
    assert "\n" not in str(refusal.value)


def test_a_full_disk_is_one_line_and_loses_nothing(tmp_path):
    run = filled(tmp_path / "run", 5)
    pages = run._connection.execute("PRAGMA page_count").fetchone()[0]
    run._connection.execute(f"PRAGMA max_page_count = {pages}")

    def fill():
        for number in range(5, 500):
            run.append(some_evaluation(number), 0)

    with pytest.raises(SearchError, match="full"):
        fill()
    stored = len(run.evaluations())
    run.close()
    with RunDirectory.open(tmp_path / "run") as again:
        assert len(again.evaluations()) == stored >= 5
