"""Many points flown on given seeds, outside of any search."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moflock_mj.errors import SearchError
from optimize.evaluation.evaluation import OK, Evaluation, EvaluationTask
from optimize.evaluation.interface import Evaluator

ProgressCallback = Callable[[int, int], None]
"""Told, after each flight, how many of how many are done."""


class FlownPoints(NamedTuple):
    """Flights of n points, S each.

    Attributes:
        fitness: (n, S, 6), or (n, S, 7) with coverage; 0, the worst, where a flight failed.
        figures: (n, S, F), in the order of FIGURE_NAMES; NaN where there are none.
        failed: (n,), how many of its flights failed.
    """

    fitness: NDArray[np.float64]
    figures: NDArray[np.float64]
    failed: NDArray[np.int64]


def evaluate_batch(
    executor: Evaluator,
    points: Sequence[NamedTuple],
    seeds: Sequence[Sequence[int]],
    told: ProgressCallback | None = None,
    variants: Sequence[int] = (),
) -> FlownPoints:
    """Fly each point once on each of its seeds.

    Args:
        executor: flies; its answers may come in any order.
        points: n parameter sets, each in its policy's own type.
        seeds: (n, S), those of each point.
        told: of progress.
        variants: which of the job's variants each point flies; none for its own scenario.
    """
    shape = (len(points), len(seeds[0]))
    # One flight in each task: the workers are then busy to the end, and progress is smooth.
    tasks = []
    for number, seed in enumerate(seed for row in seeds for seed in row):
        point = number // shape[1]
        variant = variants[point] if variants else None
        tasks.append(EvaluationTask(number, points[point], (int(seed),), variant))
    flown: dict[int, Evaluation] = {}
    for evaluation in executor.evaluate(tasks):
        flown[evaluation.number] = evaluation
        if told:
            told(len(flown), len(tasks))
    ordered = [flown[task.number] for task in tasks]
    fitness = np.array([evaluation.fitness[0] for evaluation in ordered])
    failed = np.array([evaluation.outcome != OK for evaluation in ordered])
    figures = np.array([evaluation.figures[0] for evaluation in ordered])
    return FlownPoints(fitness.reshape(*shape, -1), figures.reshape(*shape, -1), failed.reshape(shape).sum(axis=1))


def check_counts(**counts: int) -> None:
    """Refuse what is fewer than two.

    Raises:
        SearchError: one line.
    """
    for name, count in counts.items():
        if count < 2:
            raise SearchError(f"{name}: {count} is out of bounds: it must be at least 2")


def fresh_seeds(count: int, used: Collection[int] = ()) -> tuple[int, ...]:
    """The first `count` whole numbers from 1 that are not among the used ones."""
    found: list[int] = []
    seed, taken = 1, set(used)
    while len(found) < count:
        if seed not in taken:
            found.append(seed)
        seed += 1
    return tuple(found)
