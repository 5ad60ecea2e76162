"""A report of a small, real search."""

from __future__ import annotations

import re

import numpy as np
import pytest

from moflock_mj import Scenario
from moflock_mj.errors import SearchError
from optimize.analysis.pca import components_json, grouped_by_sign, study
from optimize.evaluation.evaluation import Job, evaluate
from optimize.reports.search_report import write_report
from optimize.search.configuration import Configuration, SearchConfig
from optimize.search.findings import estimated_fronts, flown_front, gather, growth
from optimize.search.run_directory import RunDirectory
from optimize.search.search import search

SCENARIO = Scenario(drones=5, duration=8.0, step=0.1, arena_side=120.0)


class Here:
    """An executor that flies in this process."""

    workers = 1

    def __init__(self, job):
        self.job = job
        self.flights = 0

    def evaluate(self, tasks):
        for task in tasks:
            self.flights += 1
            yield evaluate(self.job, task)


def searched(path, algorithm="nsga2", **changes):
    """A run directory of a search of 60 short flights."""
    settings = SearchConfig(algorithm=algorithm, population=10, budget=60)
    configuration = Configuration(scenario=SCENARIO.replace(**changes), settings=settings)
    run = RunDirectory.create(path, configuration)
    search(run, Here(configuration.job))
    return run


@pytest.fixture
def run(tmp_path):
    with searched(tmp_path / "run <1>") as made:
        yield made


@pytest.mark.slow
def test_the_report_is_one_page_and_its_figures(run, tmp_path):
    executor = Here(run.configuration.job)
    components, fitness = study(executor, run.configuration.bounds, points=40, seed=1)
    assert fitness.shape == (40, 6)
    (run.path / "pca.json").write_text(components_json(components, run.configuration.objectives))
    with searched(tmp_path / "cmaes", "cmaes") as single:
        found = gather(run, executor, compared=[single], seeds=3)
    assert "cmaes" in found.landmark_names
    page = write_report(found, tmp_path / "out")
    text = page.read_text()
    drawn = {path.stem for path in (tmp_path / "out").glob("*.png")}
    assert drawn >= {"front", "generations", "hypervolume", "pca", "parameters", "order_parameters"}
    assert text.count("<img") == len(drawn)
    assert "run &lt;1&gt;" in text
    assert not re.search(r'(src|href)="(?!data:)', text)  # nothing is fetched
    assert "0.890 ± 0.039" in text  # the paper's A, as printed


def test_what_was_flown_is_not_flown_again(run):
    executor = Here(run.configuration.job)
    first = gather(run, executor, seeds=3)
    flights = executor.flights
    second = gather(run, executor, seeds=3)
    assert executor.flights == flights
    np.testing.assert_array_equal(first.front.fitness, second.front.fitness)
    used = {seed for evaluation in run.evaluations() for seed in evaluation.seeds}
    assert not used & set(first.front.seeds)
    assert first.landmarks.seeds == first.front.seeds


def test_the_growth_of_a_run(run):
    entries = list(run.entries())
    grown = growth(run)
    assert grown.flights[-1] == sum(len(entry.evaluation.seeds) for entry in entries)
    assert ((grown.volume >= 0) & (grown.volume <= 1)).all()
    generations = estimated_fronts(entries, run.configuration.objectives)
    assert all(generation % 2 == 0 for generation in generations)


def test_a_run_of_another_scenario_is_not_compared(run, tmp_path):
    executor = Here(run.configuration.job)
    with searched(tmp_path / "other", drones=6) as other, pytest.raises(SearchError, match="scenario"):
        gather(run, executor, compared=[other], seeds=2)


def test_a_run_without_evaluations_has_no_front(tmp_path):
    configuration = Configuration(scenario=SCENARIO)
    with RunDirectory.create(tmp_path / "empty", configuration) as empty, pytest.raises(SearchError, match="no points"):
        flown_front(empty, Here(configuration.job), 2)


def test_a_study_groups_the_fitnesses_or_says_why_not():
    executor = Here(Job(scenario=SCENARIO, dynamics="point_mass"))
    components, _ = study(executor, Configuration().bounds, points=30, seed=4, sampling="latin_hypercube")
    assert components.samples == 30
    objectives = grouped_by_sign(components, SCENARIO)
    assert sorted(sum(objectives.groups, ())) == sorted(components.names)
