"""Objectives: products of groups, and the scenario that they are for."""

import numpy as np
import pytest

from moflock_mj.errors import SearchError
from moflock_mj.metrics.fitness import fitness_of
from moflock_mj.metrics.order_parameters import OrderParameters
from moflock_mj.scenario import effect_configs
from moflock_mj.scenario.scenario import Scenario
from optimize.evaluation.objectives import PAPER, Objectives, load_objectives

FITNESS = fitness_of(OrderParameters(1.0, 5.0, 0.8, 1e-5, 0.4, 5.0), Scenario())


def test_the_papers_objectives_are_those_of_the_fitness():
    np.testing.assert_allclose(PAPER.of(FITNESS), [FITNESS.F_1, FITNESS.F_2])
    np.testing.assert_allclose(PAPER.single().of(FITNESS), [FITNESS.product])


def test_columns_and_names_agree():
    columns = np.array([FITNESS[:6], FITNESS[:6]])
    np.testing.assert_allclose(PAPER.of_columns(columns), np.array([[FITNESS.F_1, FITNESS.F_2]] * 2))


def test_coverage_is_a_seventh_fitness():
    objectives = PAPER.with_coverage()
    assert objectives.coverage
    assert not PAPER.coverage
    row = [*FITNESS[:6], 0.5]
    np.testing.assert_allclose(objectives.of_columns(row), [FITNESS.F_1 * 0.5, FITNESS.F_2])


@pytest.mark.parametrize(
    ("groups", "names", "words"),
    [
        ((), (), "at least one fitness"),
        (((),), ("a",), "at least one fitness"),
        ((("wal",),), ("a",), "'wal': unknown fitness"),
        ((("wall", "wall"),), ("a",), "one objective only"),
        ((("wall",), ("corr",)), ("a",), "2 groups"),
        ((("wall",), ("corr",)), ("a", "a"), "2 groups"),
    ],
)
def test_what_makes_no_sense_is_refused(groups, names, words):
    with pytest.raises(SearchError, match=words):
        Objectives(groups=groups, names=names)


@pytest.mark.parametrize(
    "sections", [{}, {"wind": effect_configs.WindConfig(speed=8.0), "imu": effect_configs.ImuConfig()}]
)
def test_a_file_is_read_back(tmp_path, sections):
    path, scenario = tmp_path / "o.json", Scenario(drones=12, **sections)
    found = Objectives(groups=(("wall", "coll"), ("speed",)), names=("x", "y"), scenario=scenario)
    path.write_text(found.to_json())
    assert load_objectives(path, scenario) == found
    assert load_objectives(path, scenario.replace(step=0.1)) == found


@pytest.mark.parametrize("change", [{"drones": 13}, {"t_del": 0.4}, {"wind": effect_configs.WindConfig(speed=1.0)}])
def test_a_file_of_another_scenario_is_refused(tmp_path, change):
    path, scenario = tmp_path / "o.json", Scenario(drones=12)
    path.write_text(Objectives(groups=PAPER.groups, names=PAPER.names, scenario=scenario).to_json())
    name = next(iter(change))
    with pytest.raises(SearchError, match=f"another scenario: {name} is") as refusal:
        load_objectives(path, scenario.replace(**change))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "[" * 100_000,
        '{"objectives": 3}',
        '{"objectives": {"a": "wall"}}',
        '{"objectives": {"a": [1]}}',
        '{"objectives": {"a": ["wall"]}, "scenario": 4}',
        '{"objectives": {"a": ["wall"]}, "scenario": {"drons": 4}}',
        '{"objectives": {"a": ["wall"]}, "scenario": {"drones": -4}}',
    ],
)
def test_hostile_files_are_refused_in_one_line(tmp_path, text):
    path = tmp_path / "o.json"
    path.write_text(text)
    with pytest.raises(SearchError, match=r"o\.json") as refusal:
        load_objectives(path, Scenario())
    assert "\n" not in str(refusal.value)
