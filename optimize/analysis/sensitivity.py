"""How the six fitnesses depend on the parameters, one at a time and by Sobol indices, and on the scenario."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.policies.registry import values_of
from moflock_mj.errors import SearchError
from moflock_mj.parameters.bounds import ParameterBounds
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulation.simulation import Simulation
from optimize.evaluation.batch import ProgressCallback, check_counts, evaluate_batch
from optimize.evaluation.evaluation import search_scenario
from optimize.evaluation.interface import Evaluator
from optimize.evaluation.objectives import FITNESS_NAMES

SAMPLES = 64
"""Base samples of the Sobol indices; each takes D + 2 points."""

LEVELS = 9
"""Values of each parameter when it alone is changed."""


class SobolIndices(NamedTuple):
    """Of M fitnesses to the D parameters; NaN for a fitness that never varied.

    Attributes:
        first: (M, D), share of the variance that a parameter explains alone.
        total: (M, D), share that would be left if all but the parameter were known.
        first_width: (M, D), half width of the 95 % confidence interval, by bootstrap.
        total_width: (M, D).
        points: how many were flown.
    """

    first: NDArray[np.float64]
    total: NDArray[np.float64]
    first_width: NDArray[np.float64]
    total_width: NDArray[np.float64]
    points: int


class Sweep(NamedTuple):
    """A point in scenarios that differ in one field.

    Attributes:
        field: of the scenario.
        values: (L,).
        fitness: (L, S, 6).
    """

    field: str
    values: NDArray[np.float64]
    fitness: NDArray[np.float64]


class OneAtATime(NamedTuple):
    """Each parameter through its bounds, the others as in a point.

    Attributes:
        values: (D, L), of each parameter, in its unit.
        fitness: (D, L, S, 6).
    """

    values: NDArray[np.float64]
    fitness: NDArray[np.float64]


def one_at_a_time(
    executor: Evaluator,
    point: NamedTuple,
    bounds: ParameterBounds,
    *,
    seeds: tuple[int, ...],
    levels: int = LEVELS,
    told: ProgressCallback | None = None,
) -> OneAtATime:
    """Fly a point with each parameter at even levels between its bounds, on the same seeds.

    Raises:
        SearchError: fewer than two levels or seeds.
    """
    check_counts(levels=levels, seeds=len(seeds))
    values = np.linspace(bounds.lower, bounds.upper, levels).T
    base = list(values_of(point).values())
    points = np.tile(base, (len(values), levels, 1))
    for number, row in enumerate(values):
        points[number, :, number] = row
    flown = evaluate_batch(
        executor,
        [bounds.params(row) for row in points.reshape(-1, len(base))],
        [seeds] * (len(values) * levels),
        told,
    )
    return OneAtATime(values, flown.fitness.reshape(len(values), levels, len(seeds), -1))


def sobol_indices(
    executor: Evaluator,
    bounds: ParameterBounds,
    *,
    samples: int = SAMPLES,
    seed: int = 1,
    told: ProgressCallback | None = None,
) -> SobolIndices:
    """Fly Saltelli's design over the bounds, one flight per point, all on the same seed.

    On one seed the fitnesses are functions of the parameters alone, which is what the indices are of. Source: Saltelli
    et al. 2010, Variance based sensitivity analysis of model output (SALib).

    Raises:
        SearchError: see `check_samples`.
    """
    check_samples(samples)
    from SALib.sample import sobol as design  # noqa: PLC0415

    problem = {
        "num_vars": len(bounds.spec.names),
        "names": list(bounds.spec.names),
        "bounds": list(zip(bounds.lower, bounds.upper, strict=True)),
    }
    points = design.sample(problem, samples, calc_second_order=False, seed=seed)
    flown = evaluate_batch(executor, [bounds.params(point) for point in points], [(seed,)] * len(points), told)
    return _analysed(problem, flown.fitness[:, 0, : len(FITNESS_NAMES)], seed)


def check_samples(samples: int) -> None:
    """Refuse what no Sobol indices can be had of.

    Raises:
        SearchError: SALib is not installed, or the samples are no power of two.
    """
    if samples < 2 or samples & (samples - 1):
        raise SearchError(f"samples: {samples} is out of bounds: it must be a power of two of at least 2")
    try:
        import SALib  # noqa: F401, PLC0415 - an extra
    except ImportError:
        raise SearchError("sensitivity: it takes the package SALib: pip install 'moflock-mj[sensitivity]'") from None


def _analysed(problem: dict[str, Any], fitness: NDArray[np.float64], seed: int) -> SobolIndices:
    """Indices of outputs (P, M) of the design."""
    from SALib.analyze import sobol as analysis  # noqa: PLC0415

    unknown = dict.fromkeys(("S1", "ST", "S1_conf", "ST_conf"), np.full(problem["num_vars"], np.nan))
    found = [
        analysis.analyze(problem, column, calc_second_order=False, seed=seed) if np.ptp(column) > 0 else unknown
        for column in fitness.T
    ]
    first, total, first_width, total_width = (
        np.array([indices[name] for indices in found]) for name in ("S1", "ST", "S1_conf", "ST_conf")
    )
    return SobolIndices(first, total, first_width, total_width, len(fitness))


def swept_scenarios(
    point: NamedTuple, scenario: Scenario, field: str, values: Sequence[float], dynamics: str
) -> list[Scenario]:
    """The scenario with a field at each of the values, in which the point can be flown.

    Raises:
        MoflockError: it cannot.
    """
    found = [search_scenario(scenario.replace(**{field: value}), dynamics) for value in values]
    for flown in found:
        Simulation(point, flown, dynamics, seed=0)
    return found


def sweep(
    executor: Evaluator,
    point: NamedTuple,
    field: str,
    values: Sequence[float],
    *,
    variants: Sequence[int],
    seeds: tuple[int, ...],
    told: ProgressCallback | None = None,
) -> Sweep:
    """Fly a point in scenarios that differ in a field, on the same seeds.

    Args:
        executor: of a job whose variants are `swept_scenarios`.
        point: that is flown.
        field: of the scenarios.
        values: (L,), of the field.
        variants: (L,), the numbers of the job's variants that have them.
        seeds: of the flights.
        told: of progress.
    """
    flown = evaluate_batch(executor, [point] * len(values), [seeds] * len(values), told, variants)
    return Sweep(field, np.array(values, np.float64), flown.fitness)
