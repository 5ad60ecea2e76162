"""Sensitivity of the six fitnesses to the parameters (one at a time, Sobol indices) and to the scenario."""

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
"""Base samples of the Sobol indices; each requires D + 2 points."""

LEVELS = 9
"""Number of values of each parameter in a one-at-a-time study."""


class SobolIndices(NamedTuple):
    """Sobol indices of M fitnesses with respect to D parameters; NaN for a constant fitness.

    Attributes:
        first: (M, D), first-order indices: share of the variance that a parameter alone explains.
        total: (M, D), total indices: share of the variance that remains if all other parameters are known.
        first_width: (M, D), half width of the bootstrap 95 % confidence interval of `first`.
        total_width: (M, D), half width of that of `total`.
        points: number of points flown.
    """

    first: NDArray[np.float64]
    total: NDArray[np.float64]
    first_width: NDArray[np.float64]
    total_width: NDArray[np.float64]
    points: int


class Sweep(NamedTuple):
    """Fitness of a point in scenarios that differ in one field.

    Attributes:
        field: name of the field of the scenario.
        values: (L,), values of the field, in its unit.
        fitness: (L, S, 6), fitness of each flight.
    """

    field: str
    values: NDArray[np.float64]
    fitness: NDArray[np.float64]


class OneAtATime(NamedTuple):
    """Fitness along each parameter between its bounds, with the other parameters as in a point.

    Attributes:
        values: (D, L), values of each parameter, in its unit.
        fitness: (D, L, S, 6), fitness of each flight.
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
    progress: ProgressCallback | None = None,
) -> OneAtATime:
    """Fly a point with each parameter at equidistant levels between its bounds, on the same seeds.

    Raises:
        SearchError: there are fewer than two levels or seeds.
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
        progress,
    )
    return OneAtATime(values, flown.fitness.reshape(len(values), levels, len(seeds), -1))


def sobol_indices(
    executor: Evaluator,
    bounds: ParameterBounds,
    *,
    samples: int = SAMPLES,
    seed: int = 1,
    progress: ProgressCallback | None = None,
) -> SobolIndices:
    """Fly Saltelli's design over the bounds, one flight per point, all on the same seed.

    Sobol indices are defined for functions of the parameters alone, which the fitnesses are on one fixed seed.
    Source: Saltelli et al. 2010, Variance based sensitivity analysis of model output (SALib).

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
    flown = evaluate_batch(executor, [bounds.params(point) for point in points], [(seed,)] * len(points), progress)
    return _analysed(problem, flown.fitness[:, 0, : len(FITNESS_NAMES)], seed)


def check_samples(samples: int) -> None:
    """Check the number of base samples, and that SALib is installed.

    Raises:
        SearchError: SALib is not installed, or the number of samples is not a power of two.
    """
    if samples < 2 or samples & (samples - 1):
        raise SearchError(f"samples: {samples} is out of bounds: it must be a power of two of at least 2")
    try:
        import SALib  # noqa: F401, PLC0415 - an optional dependency
    except ImportError:
        raise SearchError("sensitivity: it needs the package SALib: pip install 'moflock-mj[sensitivity]'") from None


def _analysed(problem: dict[str, Any], fitness: NDArray[np.float64], seed: int) -> SobolIndices:
    """Sobol indices from the fitnesses (P, M) of the design's points."""
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
    """Scenarios with a field at each of the values.

    Raises:
        MoflockError: the point cannot be flown in one of them.
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
    progress: ProgressCallback | None = None,
) -> Sweep:
    """Fly a point in scenarios that differ in one field, on the same seeds.

    Args:
        executor: evaluator of a job whose variants are `swept_scenarios`.
        point: the point.
        field: name of the field of the scenarios.
        values: (L,), values of the field.
        variants: (L,), indices of the job's variants with these values.
        seeds: (S,), seeds of the flights at each value.
        progress: called after each flight.
    """
    flown = evaluate_batch(executor, [point] * len(values), [seeds] * len(values), progress, variants)
    return Sweep(field, np.array(values, np.float64), flown.fitness)
