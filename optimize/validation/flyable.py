"""Selection of flyable points among those that searches of rigid bodies have evaluated."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.policies.registry import DEFAULT_POLICY, POLICIES, make_params, spec_of, values_of
from moflock_mj.dynamics.airframe_models import load_airframe
from moflock_mj.metrics.verdict import FLYABLE, judge
from moflock_mj.scenario.scenario import Scenario
from optimize.evaluation.evaluation import OK, Evaluation, figure_columns
from optimize.evaluation.objectives import PAPER
from optimize.search.front import ReevaluatedFront, candidates, point_json
from optimize.search.run_directory import RunDirectory
from optimize.validation.run import Terminal, run_validation
from optimize.validation.validation import DYNAMICS, RIGID_BODY, Validation, ValidationConfig

NAMED = "steady"
"""Name of the best flyable point."""

RULE = "largest product of mean F_1 and F_2 of the points that are flyable and keep twice the least separation"
"""Rule for the choice of the named point. The separation is doubled because other seeds may give a smaller one."""


def promising_points(runs: Sequence[Path], scenario: Scenario, most: int) -> dict[str, NamedTuple]:
    """Candidates among the points that kept all limits, and twice the least separation, in all their flights.

    Args:
        runs: directories of searches of rigid bodies.
        scenario: scenario with the limits and the airframe.
        most: largest number of points.

    Returns:
        The points by name: P1, P2 and so on.
    """
    flown: defaultdict[NamedTuple, list[Evaluation]] = defaultdict(list)
    for path in runs:
        with RunDirectory.open(path) as run:
            for evaluation in run.evaluations():
                flown[evaluation.params].append(evaluation)
    kept: list[Evaluation] = []
    for evaluations in flown.values():
        figures = np.concatenate([evaluation.figures for evaluation in evaluations])
        failed = sum(evaluation.outcome != OK for evaluation in evaluations)
        if _is_safe(figures, failed, scenario):
            kept += evaluations
    points = candidates(kept, PAPER, most)
    spec = spec_of(kept[0].params) if kept else POLICIES[DEFAULT_POLICY]
    return {f"P{number}": make_params(spec, point) for number, point in enumerate(points.tolist(), 1)}


def validate_points(
    path: Path,
    points: Mapping[str, NamedTuple],
    scenario: Scenario,
    seeds: tuple[int, ...],
    workers: int,
    terminal: Terminal,
) -> Validation:
    """Validate points in a directory, or resume the validation there.

    Raises:
        MoflockError: there are no points, or see `run_validation`.
    """
    settings = ValidationConfig(scenario=scenario, points=points, seeds=seeds)
    return run_validation(path, settings, workers=workers, logs=False, terminal=terminal)[0]


def best_flyable(found: Validation) -> int | None:
    """Index of the point that `RULE` chooses; None if no point is flyable."""
    flown = zip(found.figures[RIGID_BODY], found.failed[RIGID_BODY], strict=True)
    safe = [i for i, (figures, failed) in enumerate(flown) if _is_safe(figures, int(failed), found.settings.scenario)]
    products = found.objectives[RIGID_BODY].mean(axis=1).prod(axis=1)
    return max(safe, key=lambda number: float(products[number]), default=None)


def front_on_bodies(found: Validation) -> ReevaluatedFront:
    """Front with the points of a validation and their flights as rigid bodies."""
    return ReevaluatedFront(
        objectives=PAPER,
        scenario=found.settings.scenario,
        dynamics=DYNAMICS[RIGID_BODY],
        seeds=found.settings.seeds,
        policy=found.settings.policy,
        points=np.array([list(values_of(params).values()) for params in found.settings.points.values()]),
        fitness=found.fitness[RIGID_BODY],
        failed=found.failed[RIGID_BODY],
        origin={"search": "on bodies, in three ways, by `make physics`"},
    )


def provenance(found: Validation, number: int) -> str:
    """JSON text of a point of a validation, as a named point."""
    return point_json(front_on_bodies(found), number, rule=RULE)


def _is_safe(figures: NDArray[np.float64], failed: int, scenario: Scenario) -> bool:
    """Whether flights (S, F) make a point flyable with twice the least separation."""
    diameter, limits = 2 * load_airframe(scenario.airframe).radius, scenario.verdict
    stricter = dataclasses.replace(limits, separation=2 * limits.least_separation(diameter))
    return judge(figure_columns(figures), failed, stricter, diameter).name == FLYABLE
