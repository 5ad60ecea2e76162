"""Evaluation of a batch of points on given seeds, outside a search."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moflock_mj.errors import SearchError
from optimize.evaluation.evaluation import OK, Evaluation, EvaluationTask
from optimize.evaluation.interface import Evaluator

ProgressCallback = Callable[[int, int], None]
"""Callback after each flight, with the number of finished flights and their total number."""


class FlownPoints(NamedTuple):
    """Results of n points, each with S flights.

    Attributes:
        fitness: (n, S, 6), or (n, S, 7) with coverage; 0 (the worst value) for failed flights.
        figures: (n, S, F), in the order of FIGURE_NAMES; NaN where not available.
        failed: (n,), number of failed flights of each point.
    """

    fitness: NDArray[np.float64]
    figures: NDArray[np.float64]
    failed: NDArray[np.int64]


def evaluate_batch(
    executor: Evaluator,
    points: Sequence[NamedTuple],
    seeds: Sequence[Sequence[int]],
    progress: ProgressCallback | None = None,
    variants: Sequence[int] = (),
) -> FlownPoints:
    """Fly each point once on each of its seeds.

    Args:
        executor: evaluator; its results may come in any order.
        points: n parameter sets, each of its policy's parameter type.
        seeds: (n, S), seeds of each point.
        progress: called after each flight.
        variants: (n,), index of each point's variant of the job's scenario; empty for the job's own scenario.
    """
    shape = (len(points), len(seeds[0]))
    # One flight per task keeps all workers busy until the end and makes progress smooth.
    tasks = []
    for number, seed in enumerate(seed for row in seeds for seed in row):
        point = number // shape[1]
        variant = variants[point] if variants else None
        tasks.append(EvaluationTask(number, points[point], (int(seed),), variant))
    flown: dict[int, Evaluation] = {}
    for evaluation in executor.evaluate(tasks):
        flown[evaluation.number] = evaluation
        if progress:
            progress(len(flown), len(tasks))
    ordered = [flown[task.number] for task in tasks]
    fitness = np.array([evaluation.fitness[0] for evaluation in ordered])
    failed = np.array([evaluation.outcome != OK for evaluation in ordered])
    figures = np.array([evaluation.figures[0] for evaluation in ordered])
    return FlownPoints(fitness.reshape(*shape, -1), figures.reshape(*shape, -1), failed.reshape(shape).sum(axis=1))


def check_counts(**counts: int) -> None:
    """Check that each count is at least two.

    Raises:
        SearchError: a count is less than two.
    """
    for name, count in counts.items():
        if count < 2:
            raise SearchError(f"{name}: {count} is out of bounds: it must be at least 2")


def fresh_seeds(count: int, used: Collection[int] = ()) -> tuple[int, ...]:
    """Return the `count` smallest positive integers that are not used yet."""
    found: list[int] = []
    seed, taken = 1, set(used)
    while len(found) < count:
        if seed not in taken:
            found.append(seed)
        seed += 1
    return tuple(found)
