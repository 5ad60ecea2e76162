"""The search: interrupted at any moment and resumed, it ends as one that never was."""

import subprocess
import sys
import textwrap

import numpy as np
import pytest

from controllers.policies.vasarhelyi import VasarhelyiParams
from moflock_mj.errors import SearchError
from moflock_mj.parameters.points import load_point
from optimize.evaluation.evaluation import EvaluationTask
from optimize.search.estimates import hypervolume
from optimize.search.front import candidates
from optimize.search.run_directory import RunDirectory
from optimize.search.search import search
from tests.support.search import FakeExecutor, change_archive, small_configuration


def outcome(run):
    """All of an archive that must not depend on when and where it was flown."""
    return [
        (entry.generation, flown.number, flown.params, flown.seeds, flown.fitness.tobytes(), flown.outcome)
        for entry in run.entries()
        for flown in [entry.evaluation]
    ]


def screened_outcome(run):
    return outcome(run) + outcome(run.screening)


def screened_search(run, dies_at=None, screening_dies_at=None, **more):
    """A search of "bodies" that are screened on "point masses", which are a tenth better."""
    configuration = run.configuration
    executor = FakeExecutor(configuration.job, dies_at=dies_at)
    screening = FakeExecutor(configuration.screening_job, bias=0.1, dies_at=screening_dies_at)
    return search(run, executor, screening=screening, **more)


def screened_configuration(**settings):
    return small_configuration(dynamics="rigid_body", screen=True, **settings)


def front(result):
    return [(estimate.params, estimate.mean.tobytes(), estimate.flights) for estimate in result.front]


def searched(path, configuration, **fake):
    with RunDirectory.create(path, configuration) as run:
        result = search(run, FakeExecutor(configuration.job, **fake))
        return outcome(run), result


@pytest.mark.parametrize(
    "algorithm", ["nsga2", "cmaes", *(pytest.param(name, marks=pytest.mark.slow) for name in ("unsga3", "pso"))]
)
def test_interrupted_anywhere_and_resumed_it_ends_the_same(tmp_path, algorithm):
    configuration = small_configuration(algorithm=algorithm, seeds=2, budget=120)
    expected, result = searched(tmp_path / "whole", configuration)
    with RunDirectory.create(tmp_path / "killed", configuration) as run:
        for dies_at in (3, 8, 21, 22, 47):
            with pytest.raises(KeyboardInterrupt):
                search(run, FakeExecutor(configuration.job, dies_at=dies_at))
    with RunDirectory.open(tmp_path / "killed") as run:
        executor = FakeExecutor(configuration.job)
        resumed = search(run, executor)
        assert outcome(run) == expected
    assert executor.flown == list(range(47, len(expected)))
    assert resumed.replayed == 47
    assert front(resumed) == front(result)
    assert resumed.complete


@pytest.mark.slow
def test_a_search_that_is_killed_and_resumed_ends_the_same(tmp_path):
    configuration = small_configuration(budget=200)
    expected, result = searched(tmp_path / "whole", configuration)
    program = textwrap.dedent(
        """
        import sys
        from optimize.search.run_directory import RunDirectory
        from optimize.search.search import search
        from tests.support.search import FakeExecutor, small_configuration
        configuration = small_configuration(budget=200)
        with RunDirectory.create(sys.argv[1], configuration) as run:
            search(run, FakeExecutor(configuration.job), lambda told: print(told.evaluations, flush=True))
        """
    )
    killed = subprocess.Popen([sys.executable, "-c", program, tmp_path / "killed"], stdout=subprocess.PIPE, text=True)
    while int(killed.stdout.readline()) < 77:
        pass
    killed.kill()
    killed.communicate()
    with RunDirectory.open(tmp_path / "killed") as run:
        assert 77 <= len(run.evaluations()) < len(expected)
        assert front(search(run, FakeExecutor(configuration.job))) == front(result)
        assert outcome(run) == expected


def test_a_finished_search_flies_nothing_when_it_is_resumed(tmp_path):
    configuration = small_configuration()
    expected, result = searched(tmp_path / "run", configuration)
    with RunDirectory.open(tmp_path / "run") as run:
        executor = FakeExecutor(configuration.job)
        again = search(run, executor)
        assert (outcome(run), front(again), executor.flown) == (expected, front(result), [])


def test_the_order_of_completion_changes_nothing(tmp_path):
    configuration = small_configuration()
    forwards, result = searched(tmp_path / "a", configuration)
    backwards, other = searched(tmp_path / "b", configuration, backwards=True)
    assert (forwards, front(result)) == (backwards, front(other))


def test_rows_that_are_damaged_are_flown_again(tmp_path):
    configuration = small_configuration()
    expected, _ = searched(tmp_path / "run", configuration)
    change_archive(tmp_path / "run", "UPDATE evaluations SET r0_rep = 31.0 WHERE number IN (5, 30)")
    with RunDirectory.open(tmp_path / "run") as run:
        executor = FakeExecutor(configuration.job)
        search(run, executor)
        assert executor.flown == [5, 30]
        assert outcome(run) == expected


def test_a_stop_ends_it_and_it_can_be_resumed(tmp_path):
    configuration = small_configuration()
    expected, _ = searched(tmp_path / "whole", configuration)
    told = []
    with RunDirectory.create(tmp_path / "stopped", configuration) as run:
        stopped = search(run, FakeExecutor(configuration.job), told.append, stop=lambda: len(told) >= 13)
        assert not stopped.complete
        assert stopped.evaluations == 13
        assert search(run, FakeExecutor(configuration.job)).complete
        assert outcome(run) == expected


def test_progress_counts_flights_up_to_the_budget(tmp_path):
    configuration, told = small_configuration(seeds=2, budget=100), []
    with RunDirectory.create(tmp_path / "run", configuration) as run:
        result = search(run, FakeExecutor(configuration.job), told.append)
    assert [progress.evaluations for progress in told] == list(range(1, len(told) + 1))
    assert told[-1].flights == result.flights <= 100
    assert told[0].hypervolume is None
    assert 0 < told[-1].hypervolume <= 1
    assert told[-1].seconds_left >= 0


def test_infeasible_points_are_the_worst_and_are_counted(tmp_path):
    configuration = small_configuration()
    _, result = searched(tmp_path / "run", configuration, fails=(1, 9, 10))
    assert result.infeasible == 3
    assert all(np.isfinite(estimate.mean).all() and (estimate.mean > 0).any() for estimate in result.front)


def test_an_archive_of_another_search_is_refused(tmp_path):
    configuration = small_configuration()
    searched(tmp_path / "run", configuration)
    text = (tmp_path / "run" / "configuration.json").read_text()
    (tmp_path / "run" / "configuration.json").write_text(text.replace('"seed": 1', '"seed": 2'))
    with RunDirectory.open(tmp_path / "run") as run, pytest.raises(SearchError, match="configuration was changed"):
        search(run, FakeExecutor(configuration.job))


@pytest.mark.slow
def test_more_flights_of_the_same_noise_find_a_better_front(tmp_path):
    small = searched(tmp_path / "a", small_configuration(budget=60))[1]
    large = searched(tmp_path / "b", small_configuration(budget=400))[1]
    assert large.hypervolume > small.hypervolume


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"budget": 7}, "budget: 7 flights; it must be at least one generation, 8"),
        ({"algorithm": "nsga4"}, "algorithm: 'nsga4' is out of bounds: it must be one of nsga2"),
        ({"seeds": 0}, "seeds: 0 is out of bounds"),
        ({"population": 2.5}, "population: 2.5 is of the wrong type"),
        ({"unbounded": True}, "unbounded: only cmaes"),
        ({"timeout": -1}, "timeout: -1.0 is out of bounds"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, words):
    with pytest.raises(SearchError, match=words):
        small_configuration(**settings)


def test_a_screened_search_flies_all_offspring_on_point_masses_and_few_on_bodies(tmp_path):
    told = []
    with RunDirectory.create(tmp_path / "run", screened_configuration(budget=100)) as run:
        result = screened_search(run, progress=told.append)
        offspring = {flown.params for flown in run.screening.evaluations()}
        assert {flown.params for flown in run.evaluations()} <= offspring
        assert len(run.evaluations()) == result.flights == result.evaluations <= 100
        assert len(run.screening.evaluations()) == result.screened > 2 * result.flights
    assert told[0].flights == 0
    assert told[0].seconds_left is None
    assert (told[-1].flights, told[-1].screened) == (result.flights, result.screened)


def test_a_screened_search_killed_anywhere_and_resumed_ends_the_same(tmp_path):
    configuration = screened_configuration(seeds=2, budget=100)
    with RunDirectory.create(tmp_path / "whole", configuration) as run:
        result, expected = screened_search(run), screened_outcome(run)
    with RunDirectory.create(tmp_path / "killed", configuration) as run:
        for deaths in ({"screening_dies_at": 5}, {"dies_at": 2}, {"screening_dies_at": 40}, {"dies_at": 17}):
            with pytest.raises(KeyboardInterrupt):
                screened_search(run, **deaths)
    with RunDirectory.open(tmp_path / "killed") as run:
        resumed = screened_search(run)
        assert screened_outcome(run) == expected
    assert front(resumed) == front(result)
    assert resumed.replayed == 17


def test_rows_of_point_masses_that_are_damaged_are_flown_again(tmp_path):
    with RunDirectory.create(tmp_path / "run", screened_configuration()) as run:
        screened_search(run)
        expected = screened_outcome(run)
        run.screening._connection.execute("UPDATE evaluations SET r0_rep = 31.0 WHERE number IN (5, 30)")
        run.screening._connection.commit()
    with RunDirectory.open(tmp_path / "run") as run:
        assert run.count_damaged() == 2
        screened_search(run)
        assert screened_outcome(run) == expected


def test_a_search_starts_from_points_and_resumes_the_same(tmp_path):
    start = (load_point("A"), load_point("B"))
    configuration = small_configuration(seeds=2, budget=80).replace(start=start)
    expected, _ = searched(tmp_path / "whole", configuration)
    flown = [np.array(params) for generation, _, params, *_ in expected if generation == 0]
    for point in start:
        assert any(np.allclose(point, params, rtol=1e-12) for params in flown)
    with RunDirectory.create(tmp_path / "killed", configuration) as run, pytest.raises(KeyboardInterrupt):
        search(run, FakeExecutor(configuration.job, dies_at=11))
    with RunDirectory.open(tmp_path / "killed") as run:
        assert run.configuration == configuration
        search(run, FakeExecutor(configuration.job))
        assert outcome(run) == expected


@pytest.mark.slow
def test_as_many_flights_of_bodies_find_a_better_front_with_screening(tmp_path):
    """Noise as of flights; over three seeds, since each search has luck of its own."""
    plain, screened = [], []
    for seed in (1, 2, 3):
        settings = {"seed": seed, "population": 12, "budget": 96}
        with RunDirectory.create(tmp_path / f"plain-{seed}", small_configuration(**settings)) as run:
            search(run, FakeExecutor(run.configuration.job, noise=0.2))
            plain.append(true_hypervolume(run))
        with RunDirectory.create(tmp_path / f"screened-{seed}", screened_configuration(**settings)) as run:
            job = run.configuration.screening_job
            screening = FakeExecutor(job, noise=0.2, bias=0.1)
            search(run, FakeExecutor(run.configuration.job, noise=0.2), screening=screening)
            screened.append(true_hypervolume(run))
    assert np.mean(screened) > np.mean(plain) + 0.02


def true_hypervolume(run):
    """Of a search's candidates, without noise."""
    points = candidates(run.evaluations(), run.configuration.objectives, 12)
    tasks = [EvaluationTask(number, VasarhelyiParams(*point), (1,)) for number, point in enumerate(points.tolist())]
    flown = FakeExecutor(run.configuration.job, noise=0.0).evaluate(tasks)
    return hypervolume([run.configuration.objectives.of_columns(flight.fitness[0]) for flight in flown])
