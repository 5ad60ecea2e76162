"""Test doubles for the flights of a search, and access to the rows of an archive."""

import contextlib
import sqlite3

import numpy as np

from moflock_mj.parameters.bounds import policy_bounds
from moflock_mj.parameters.points import load_point
from moflock_mj.scenario.scenario import Scenario
from optimize.evaluation.evaluation import Evaluation, infeasible
from optimize.search.configuration import Configuration, SearchConfig

TINY = ("--drones", "4", "--duration", "4")
"""Options of short flights."""
SMALL = (*TINY, "--budget", "40", "--population", "8", "--workers", "1")
"""Options of a search that takes a few seconds."""


class FakeExecutor:
    """Executor that evaluates a closed form in this process: F_1 grows with the first coordinate, F_2 falls with it.

    Both decrease with the distance of the other eleven coordinates from 0.3, and have noise that depends on the seed.

    Args:
        job: job of a search.
        noise: standard deviation of an objective.
        backwards: whether the tasks are evaluated in reverse order.
        fails: numbers of the tasks that are infeasible.
        dies_at: number of the evaluation before which KeyboardInterrupt is raised.
        bias: offset of both objectives.
    """

    workers = 1

    def __init__(self, job, noise=0.05, backwards=False, fails=(), dies_at=None, bias=0.0):
        self.job, self.noise, self.backwards, self.fails, self.dies_at = job, noise, backwards, fails, dies_at
        self.bias = bias
        self.flown = []

    def evaluate(self, tasks):
        for task in reversed(tasks) if self.backwards else tasks:
            if task.number == self.dies_at:
                raise KeyboardInterrupt
            self.flown.append(task.number)
            yield infeasible(self.job, task, "fake") if task.number in self.fails else self._fly(task)

    def _fly(self, task):
        unit = policy_bounds().to_unit(task.params)
        distance = np.abs(unit[1:] - 0.3).mean()
        rows = []
        for seed in task.seeds:
            noise = self.noise * np.random.default_rng(seed).standard_normal(2)
            f_1, f_2 = np.clip(
                np.array([np.sqrt(abs(unit[0])), np.sqrt(abs(1 - unit[0]))]) - distance + self.bias + noise, 0, 1
            )
            rows.append([f_1, 1, f_2, 1, 1, 1])
        return Evaluation(
            task.number,
            task.params,
            task.seeds,
            np.ones((len(rows), 6)),
            np.array(rows),
            np.ones((len(rows), 12)),
            0.01,
            "fake",
            "ok",
        )

    def close(self):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *problem):
        pass


def small_configuration(**settings):
    """Configuration of a search with a few points in a tiny scenario."""
    tiny = Scenario(drones=4, arena_side=100.0, duration=2.0, step=0.1)
    return Configuration(scenario=tiny, settings=SearchConfig(**{"population": 8, "budget": 60} | settings))


def some_evaluation(number, flights=2):
    """Evaluation with random values, deterministic in its number."""
    rng = np.random.default_rng(number)
    return Evaluation(
        number=number,
        params=load_point("A")._replace(r0_rep=30 + rng.random()),
        seeds=tuple(rng.integers(1, 2**31, flights).tolist()),
        order_parameters=rng.random((flights, 6)),
        fitness=rng.random((flights, 6)),
        figures=rng.random((flights, 12)),
        seconds=0.1,
        worker="here",
        outcome="ok",
    )


def rows_of(path, columns):
    """Columns of all evaluations in a run directory, in the order of their numbers; none before the table exists."""
    with contextlib.closing(sqlite3.connect(path / "archive.sqlite")) as archive:
        try:
            return archive.execute(f"SELECT {columns} FROM evaluations ORDER BY number").fetchall()
        except sqlite3.OperationalError:
            return []


def points_of(path):
    """Number, two parameters, seeds and fitness of each evaluation in a run directory."""
    return rows_of(path, "number, r0_rep, a_shill, seeds, fitness")


def evaluations_in(path):
    """Number of evaluations in a run directory, which another process may still be creating."""
    return len(rows_of(path, "number")) if (path / "archive.sqlite").exists() else 0


def change_archive(path, statement):
    """Run an SQL statement on the archive of a run directory, to damage it."""
    with contextlib.closing(sqlite3.connect(path / "archive.sqlite")) as connection, connection:
        connection.execute(statement)
