"""Local workers: whoever flies, whatever happens, each task comes back once."""

import os
import signal
import threading
import time

import numpy as np
import pytest

from moflock_mj.errors import MoflockError, SearchError
from moflock_mj.flight import fly
from moflock_mj.parameters.points import load_point
from moflock_mj.scenario.scenario import Scenario
from optimize.evaluation.coverage import coverage
from optimize.evaluation.evaluation import EvaluationTask, Job, evaluate
from optimize.evaluation.executors import make_executor
from optimize.evaluation.local_executor import LocalExecutor, _Worker

TINY = Scenario(drones=5, arena_side=120.0, duration=10.0, step=0.1)
LONG = TINY.replace(drones=30, duration=20_000.0)
"""Flies for several seconds."""


def tasks_of(count, seeds=(1, 2)):
    return [EvaluationTask(i, load_point("A" if i % 2 else "B")._replace(r0_rep=31.0 + i), seeds) for i in range(count)]


def gather(executor, tasks):
    found = list(executor.evaluate(tasks))
    assert sorted(evaluation.number for evaluation in found) == [task.number for task in tasks], "each exactly once"
    return {evaluation.number: evaluation for evaluation in found}


def bits(evaluations):
    return {
        number: (e.params, e.seeds, e.fitness.tobytes(), e.order_parameters.tobytes())
        for number, e in evaluations.items()
    }


def children():
    """Processes of this one, by number."""
    with open(f"/proc/self/task/{os.getpid()}/children") as listed:  # noqa: PTH123
        return {int(pid) for pid in listed.read().split()}


def command_of(pid):
    with open(f"/proc/{pid}/cmdline") as command:  # noqa: PTH123
        return command.read()


def workers_since(before):
    """Processes of an executor that has been made since."""
    return [pid for pid in children() - before if "resource_tracker" not in command_of(pid)]


def test_an_evaluation_is_the_flight_of_each_seed():
    job = Job(scenario=TINY, dynamics="point_mass", coverage=True)
    found = evaluate(job, EvaluationTask(7, load_point("A"), (3, 4)))
    assert (found.number, found.outcome, found.fitness.shape) == (7, "ok", (2, 7))
    flight = fly(load_point("A"), scenario=TINY, dynamics="point_mass", seed=4)
    np.testing.assert_array_equal(found.order_parameters[1], flight.order_parameters)
    np.testing.assert_array_equal(found.fitness[1, :6], flight.fitness[:6])
    assert found.fitness[1, 6] == coverage(flight.samples.position, TINY.arena)[-1]


@pytest.mark.parametrize("dynamics", ["point_mass", "rigid_body"])
def test_common_random_numbers_and_seeds_that_differ(dynamics):
    job = Job(scenario=TINY.replace(duration=2.0, step=None), dynamics=dynamics)
    one, two = (evaluate(job, EvaluationTask(0, load_point("A"), (5, 6))) for _ in range(2))
    np.testing.assert_array_equal(one.fitness, two.fitness)
    assert (one.order_parameters[0] != one.order_parameters[1]).any()


def test_a_point_that_cannot_be_flown_is_infeasible_and_not_nan():
    found = evaluate(
        Job(scenario=TINY, dynamics="point_mass"), EvaluationTask(0, load_point("A")._replace(p_frict=-1.0), (1,))
    )
    assert found.outcome.startswith("p_frict: -1.0 is out of bounds")
    assert found.fitness.tolist() == [[0.0] * 6]


@pytest.mark.slow
def test_one_worker_two_and_none_give_the_same():
    job, tasks = Job(scenario=TINY, dynamics="point_mass"), tasks_of(12)
    here = {task.number: evaluate(job, task) for task in tasks}
    with LocalExecutor(job, 1) as one, LocalExecutor(job, 2) as two:
        assert bits(gather(one, tasks)) == bits(gather(two, tasks)) == bits(here)
        assert gather(two, []) == {}
        assert bits(gather(two, tasks)) == bits(here), "an executor may be used again"


@pytest.mark.slow
def test_a_killed_worker_is_replaced_and_its_task_flown_again():
    job, tasks, before = Job(scenario=TINY.replace(duration=2000.0), dynamics="point_mass"), tasks_of(10), children()
    with LocalExecutor(job, 2) as executor:
        victim = workers_since(before)[0]
        threading.Timer(0.3, os.kill, (victim, signal.SIGKILL)).start()
        found = gather(executor, tasks)
        assert victim not in children() - before
    assert all(evaluation.outcome == "ok" for evaluation in found.values())
    assert bits(found) == bits({task.number: evaluate(job, task) for task in tasks})


@pytest.mark.slow
def test_a_task_that_kills_each_worker_is_infeasible_and_the_others_fly():
    job = Job(scenario=LONG, dynamics="point_mass")
    with LocalExecutor(job, 1) as executor:
        over = threading.Event()

        def kill_whoever_flies():
            while not over.wait(0.05):
                worker = executor._workers[0]
                if worker.task and worker.busy_seconds > 0.1:
                    os.kill(worker._process.pid, signal.SIGKILL)
                    over.wait(0.5)

        killer = threading.Thread(target=kill_whoever_flies)
        killer.start()
        found = next(executor.evaluate(tasks_of(1)))
        over.set()
        killer.join()
    assert found.outcome == "the worker died (exit code -9)"
    assert not found.fitness.any()


@pytest.mark.slow
def test_an_evaluation_that_takes_too_long_notices_by_itself():
    with LocalExecutor(Job(scenario=LONG, dynamics="point_mass", timeout=0.2), 1) as executor:
        (found,) = gather(executor, tasks_of(1)).values()
    assert found.outcome == "TimeoutError: timed out after 0.2 s"


@pytest.mark.slow
def test_a_worker_that_hangs_is_killed(monkeypatch):
    monkeypatch.setattr("optimize.evaluation.local_executor._GRACE", 0.5)
    before = children()
    with LocalExecutor(Job(scenario=TINY, dynamics="point_mass", timeout=0.3), 1) as executor:
        (hung,) = workers_since(before)
        os.kill(hung, signal.SIGSTOP)
        began = time.monotonic()
        (found,) = gather(executor, tasks_of(1)).values()
        assert hung not in workers_since(before)
    assert found.outcome == "ok", "on a fresh worker"
    assert time.monotonic() - began < 20


def test_evaluations_that_are_left_in_the_middle_do_not_come_later():
    with LocalExecutor(Job(scenario=TINY, dynamics="point_mass"), 2) as executor:
        next(iter(executor.evaluate(tasks_of(8, seeds=(1,)))))
        found = gather(executor, tasks_of(4, seeds=(9,)))
    assert all(evaluation.seeds == (9,) for evaluation in found.values())


@pytest.mark.slow
def test_no_process_outlives_its_executor():
    before = children()
    executor = LocalExecutor(Job(scenario=TINY, dynamics="point_mass"), 2)
    executor.close()
    assert workers_since(before) == []


@pytest.mark.slow
def test_ctrl_c_is_no_affair_of_a_worker_that_is_starting():
    worker = _Worker(Job(scenario=TINY, dynamics="point_mass"))
    try:
        os.kill(worker._process.pid, signal.SIGINT)
        worker.receive()
        assert worker.ready
    finally:
        worker.end()


@pytest.mark.slow
def test_ctrl_c_is_the_parents():
    before = children()
    with LocalExecutor(Job(scenario=TINY, dynamics="point_mass"), 1) as executor:
        (worker,) = workers_since(before)
        os.kill(worker, signal.SIGINT)
        gather(executor, tasks_of(2))
        assert workers_since(before) == [worker]


@pytest.mark.parametrize("workers", [0, -1, 100_000])
def test_a_number_of_workers_that_makes_no_sense_is_refused(workers):
    with pytest.raises(SearchError, match=f"workers: {workers} is out of bounds"):
        make_executor(Job(scenario=TINY, dynamics="point_mass"), workers)


def test_a_job_that_cannot_be_flown_is_refused_at_once():
    with pytest.raises(MoflockError, match="whole multiple"):
        make_executor(Job(scenario=TINY.replace(step=None, t_gps=0.013), dynamics="rigid_body"))
