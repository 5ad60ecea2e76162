"""The same evaluations on a Dask cluster: a real scheduler and two workers on loopback."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from moflock_mj.errors import SearchError
from moflock_mj.parameters.points import load_point
from moflock_mj.scenario.scenario import Scenario
from optimize.evaluation.evaluation import EvaluationTask, Job, evaluate
from optimize.evaluation.executors import make_executor
from tests.support.cli import run
from tests.support.waiting import wait_until

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
# Dask's own sockets and event loops are closed by its garbage collection.
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("default")]

TINY = Scenario(drones=5, arena_side=120.0, duration=100.0, step=0.1)
JOB = Job(scenario=TINY, dynamics="point_mass")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def start(folder, kind, *arguments):
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, [str(Path.cwd()), os.environ.get("PYTHONPATH")]))
    }
    with open(folder / f"{kind}-{time.monotonic_ns()}.log", "wb") as log:  # noqa: PTH123
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{kind}", *arguments],
            stdout=log,
            stderr=log,
            cwd=folder,
            env=environment,
        )


def wait_for_port(port):
    """A busy machine takes longer to start a scheduler than a client waits for one."""

    def answers():
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
            return True
        return False

    wait_until(answers, pause=0.1)


@contextlib.contextmanager
def running_cluster(folder, count):
    """A scheduler's address, and the processes of the scheduler and its workers."""
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    scheduler = start(folder, "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
    options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--memory-limit", "0", "--death-timeout", "60")
    workers = [start(folder, "worker", address, *options) for _ in range(count)]
    try:
        wait_for_port(port)
        yield address, scheduler, workers
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


def wait_for_workers(executor, count):
    wait_until(lambda: executor.workers == count, pause=0.1)


def tasks_of(count):
    return [EvaluationTask(i, load_point("A")._replace(r0_rep=31.0 + i / 10), (i, i + 1)) for i in range(count)]


def test_a_worker_killed_in_the_middle_loses_nothing_and_nothing_counts_twice(tmp_path):
    tasks, found = tasks_of(16), []
    with running_cluster(tmp_path, 2) as (address, _, workers), make_executor(JOB, scheduler=address) as executor:
        wait_for_workers(executor, 2)
        for evaluation in executor.evaluate(tasks):
            found.append(evaluation)
            if len(found) == 3:
                workers[0].send_signal(signal.SIGKILL)
    assert sorted(evaluation.number for evaluation in found) == list(range(16))
    assert {evaluation.outcome for evaluation in found} == {"ok"}
    for evaluation in found:
        here = evaluate(JOB, tasks[evaluation.number])
        assert here.fitness.tobytes() == evaluation.fitness.tobytes()


def test_what_fails_is_infeasible_and_a_scheduler_that_goes_away_is_one_line(tmp_path):
    late = Job(scenario=TINY.replace(drones=30, duration=20_000.0), dynamics="point_mass", timeout=0.1)
    with running_cluster(tmp_path, 1) as (address, scheduler, _):
        with make_executor(late, scheduler=address) as executor:
            found = list(executor.evaluate(tasks_of(2)))
        assert [evaluation.outcome for evaluation in found] == ["TimeoutError: timed out after 0.1 s"] * 2
        with make_executor(JOB, scheduler=address) as executor:
            evaluations = executor.evaluate(tasks_of(300))
            next(evaluations)
            scheduler.kill()
            began = time.monotonic()
            with pytest.raises(SearchError, match="scheduler: it is gone"):
                list(evaluations)
        assert time.monotonic() - began < 60


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x", "tcp://"])
def test_an_unreachable_scheduler_is_one_line_within_seconds(address):
    began = time.monotonic()
    with pytest.raises(SearchError, match="scheduler") as refusal:
        make_executor(JOB, scheduler=address)
    assert "\n" not in str(refusal.value)
    assert time.monotonic() - began < 20


def test_a_validation_on_a_cluster_is_the_one_that_is_flown_here(tmp_path):
    """Two crews, of point masses and of bodies, and the standard faults on bodies, share the cluster."""
    wish = ("validate", "A", "--seeds", 2, "--fault-seeds", 2, "--faults", "--no-logs", "--drones", 3, "--duration", 60)
    here = run(*wish, "--workers", 1, "--out", tmp_path / "here", "--json")
    with running_cluster(tmp_path, 1) as (address, _, _):
        there = run(*wish, "--scheduler", address, "--out", tmp_path / "there", "--json")
    assert there.stderr == ""
    assert json.loads(there.stdout) == json.loads(here.stdout)
