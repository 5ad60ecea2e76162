"""Sensitivity: indices of functions whose indices are known, and the command on a tiny flock."""

import json

import numpy as np
import pytest

from controllers.policies.reynolds import ReynoldsParams
from controllers.policies.vasarhelyi import VasarhelyiParams
from moflock_mj.parameters.bounds import policy_bounds
from moflock_mj.parameters.points import dump_point, load_point
from optimize.analysis.sensitivity import one_at_a_time, sobol_indices
from optimize.evaluation.evaluation import Evaluation
from tests.support.cli import refused, run


class Linear:
    """F_wall is a weighted sum of the first two coordinates; F_speed their product about the middle; the rest is 1."""

    workers = 1

    def evaluate(self, tasks):
        for task in tasks:
            unit = policy_bounds().to_unit(task.params)
            row = [(3 * unit[0] + unit[1]) / 4, 4 * (unit[0] - 0.5) * (unit[1] - 0.5), 1, 1, 1, 1]
            fitness = np.array([row] * len(task.seeds))
            figures = np.zeros((len(task.seeds), 12))
            yield Evaluation(task.number, task.params, task.seeds, fitness, fitness, figures, 0.0, "fake", "ok")


def test_indices_are_those_known_in_closed_form():
    """A sum's first-order indices are its weights squared; a centred product has none, and totals of 1."""
    found = sobol_indices(Linear(), policy_bounds(), samples=512)
    np.testing.assert_allclose(found.first[0, :3], [0.9, 0.1, 0.0], atol=0.05)
    np.testing.assert_allclose(found.total[0, :3], [0.9, 0.1, 0.0], atol=0.05)
    np.testing.assert_allclose(found.first[1, :3], 0.0, atol=0.1)
    np.testing.assert_allclose(found.total[1, :3], [1.0, 1.0, 0.0], atol=0.1)
    assert np.isnan(found.first[2:]).all()  # these never varied
    assert found.points == 512 * 14


def test_one_parameter_at_a_time_goes_through_its_bounds():
    point, bounds = load_point("A"), policy_bounds()
    found = one_at_a_time(Linear(), point, bounds, seeds=(1, 2), levels=3)
    assert found.values.shape == (12, 3)
    np.testing.assert_allclose(found.values[:, [0, -1]].T, [bounds.lower, bounds.upper])
    np.testing.assert_allclose(np.diff(found.fitness[0, :, 0, 0]), 3 / 8)
    np.testing.assert_allclose(np.diff(found.fitness[5, :, 0, 0]), 0)


@pytest.mark.slow
def test_the_command_writes_a_figure_and_json(tmp_path):
    asked = ("--samples", 2, "--levels", 2, "--seeds", 2, "--drones", 3, "--duration", 2, "--workers", 1)
    done = run("sensitivity", "B", *asked, "--out", tmp_path / "s")
    assert done.returncode == 0, done.stderr
    told = json.loads((tmp_path / "s" / "sensitivity.json").read_text())
    assert told["parameters"] == list(VasarhelyiParams._fields)
    assert np.array(told["one_at_a_time"]["fitness"]).shape == (12, 2, 2, 6)
    assert (tmp_path / "s" / "sensitivity.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("C",), "point C"),
        (("A", "--samples", "3"), "samples: 3"),
        (("A", "--samples", "2", "--seeds", "1"), "seeds: 1"),
    ],
)
def test_bad_input_gets_one_line(arguments, words, tmp_path):
    tiny = ("--drones", "3", "--duration", "1", "--workers", "1")
    assert words in refused("sensitivity", *arguments, *tiny, "--out", tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_a_sweep_writes_a_figure_of_each_field(tmp_path):
    asked = ("--drones", "2,4", "--t-del", "0,0.5", "--seeds", 2, "--duration", 2, "--workers", 1, "--json")
    done = run("sweep", "B", *asked, "--out", tmp_path / "s")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)["sweeps"]
    assert np.array(told["drones"]["fitness"]).shape == np.array(told["t_del"]["fitness"]).shape == (2, 2, 6)
    assert {path.name for path in (tmp_path / "s").iterdir()} >= {"drones.png", "t_del.png", "sweeps.json"}


def test_a_point_of_another_policy_is_swept_and_needs_bounds_of_its_own(tmp_path):
    point = tmp_path / "reynolds.json"
    point.write_text(dump_point(ReynoldsParams(150.0, 0.02, 0.8, 0.3, 13.6, 3.02, 3.55, 1.0)))
    asked = ("--drones", 3, "--seeds", 2, "--duration", 2, "--workers", 1, "--json")
    done = run("sweep", point, *asked, "--out", tmp_path / "s")
    assert done.returncode == 0, done.stderr
    assert np.isfinite(json.loads(done.stdout)["sweeps"]["drones"]["fitness"]).all()
    assert "bounds: policy 'vasarhelyi'" in refused("sensitivity", point, "--samples", 2)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "sweep: no field is given"),
        (("--drones", "2,x"), "drones: '2,x'"),
        (("--drones", "2,0"), "drones: 0"),
        (("--t-del", "0.123"), "t_del: 0.123 s"),
        (("--drones", "2", "--t-del", "0.123"), "t_del: 0.123 s"),
        (("--drones", "2", "--seeds", "1"), "seeds: 1"),
    ],
)
def test_a_bad_sweep_gets_one_line(arguments, words, tmp_path):
    assert words in refused("sweep", "A", *arguments, "--duration", "1", "--workers", "1", "--out", tmp_path / "s")
    assert not (tmp_path / "s").exists()
