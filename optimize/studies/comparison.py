"""Comparison of searches with equal budgets by their results on fresh seeds, over several runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optimize.search.front import ReevaluatedFront

SEEDS = 40
"""Number of fresh seeds for the comparison of fronts."""

COMPETITORS: Mapping[str, Mapping[str, Any]] = {
    "NSGA-II": {"algorithm": "nsga2"},
    "U-NSGA-III": {"algorithm": "unsga3"},
    "NSGA-II, one fixed seed": {"algorithm": "nsga2", "noise": "fixed"},
    "CMA-ES": {"algorithm": "cmaes"},
    "PSO": {"algorithm": "pso"},
}
"""Settings of the compared searches, by name."""


class Score(NamedTuple):
    """Results of R runs of one search.

    Attributes:
        hypervolume: (R,), hypervolume of the mean objectives.
        product: (R,), largest mean over the points of the product of all objectives.
        best: (R, K), largest mean over the points of each objective.
    """

    hypervolume: NDArray[np.float64]
    product: NDArray[np.float64]
    best: NDArray[np.float64]


def score(fronts: Sequence[ReevaluatedFront], seeds: int = SEEDS) -> Score:
    """Score the fronts of a search's runs on their first `seeds` fresh seeds.

    Args:
        fronts: fronts of the R runs, flown on at least `seeds` seeds.
        seeds: number of seeds.
    """
    equal = [
        dataclasses.replace(front, seeds=front.seeds[:seeds], fitness=front.fitness[:, :seeds]) for front in fronts
    ]
    return Score(
        hypervolume=np.array([front.hypervolume for front in equal]),
        product=np.array([front.values.prod(axis=2).mean(axis=1).max() for front in equal]),
        best=np.array([front.mean.max(axis=0) for front in equal]),
    )
