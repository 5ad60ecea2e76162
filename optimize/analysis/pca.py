"""Principal components of the fitnesses, and the objectives that follow from their signs.

Source: Bansal, Sethi, Anicho and Nagar, sections Background and Dimensionality reduction using PCA; scikit-learn.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc
from sklearn.decomposition import PCA
from sklearn.preprocessing import StandardScaler

from moflock_mj.errors import SearchError
from moflock_mj.parameters.bounds import ParameterBounds
from moflock_mj.scenario.scenario import Scenario
from optimize.analysis.published_results import COVARIANCE, FIRST_COMPONENT
from optimize.evaluation.batch import ProgressCallback, check_counts, evaluate_batch
from optimize.evaluation.interface import Evaluator
from optimize.evaluation.objectives import FITNESS_NAMES, Objectives

SAMPLINGS = ("uniform", "latin_hypercube")
"""Ways to spread random points."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class PrincipalComponents:
    """Principal components of M standardised variables.

    Attributes:
        names: (M,), names of the variables.
        samples: number of samples.
        mean: (M,), mean of each variable before standardisation.
        deviation: (M,), standard deviation of each variable before standardisation.
        covariance: (M, M), of the standardised variables, normalised by samples - 1.
        components: (M, M), one unit vector per row, in the order of decreasing variance.
        explained: (M,), share of the variance along each component.
    """

    names: tuple[str, ...]
    samples: int
    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]
    covariance: NDArray[np.float64]
    components: NDArray[np.float64]
    explained: NDArray[np.float64]

    @property
    def constant(self) -> tuple[str, ...]:
        """Names of the variables that are constant over the samples; their weights are 0."""
        return tuple(name for name, own in zip(self.names, np.diag(self.covariance), strict=True) if own == 0)

    def to_dict(self) -> dict[str, Any]:
        """Attributes as JSON values."""
        content = dataclasses.asdict(self)
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in content.items()}


def load_components(path: str | Path) -> PrincipalComponents:
    """Read the components stored under "pca" in a file that `components_json` wrote.

    Raises:
        SearchError: the file cannot be read or holds no components.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))["pca"]
        arrays = ("mean", "deviation", "covariance", "components", "explained")
        return PrincipalComponents(
            names=tuple(content["names"]),
            samples=int(content["samples"]),
            **{name: np.asarray(content[name], np.float64) for name in arrays},
        )
    except OSError as error:
        raise SearchError(f"pca {path}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise SearchError(f"pca {path}: not a principal component analysis: {error}") from None


def components_json(found: PrincipalComponents, objectives: Objectives) -> str:
    """JSON text of the objectives, as `load_objectives` reads it, with the components under "pca"."""
    return json.dumps({**json.loads(objectives.to_json()), "pca": found.to_dict()}, indent=1) + "\n"


def random_points(
    bounds: ParameterBounds, count: int, rng: np.random.Generator, sampling: str = "uniform"
) -> NDArray[np.float64]:
    """Random points inside the bounds.

    Args:
        bounds: bounds of the D parameters.
        count: number of points.
        rng: random number generator.
        sampling: "uniform" or "latin_hypercube" (McKay, Beckman and Conover 1979).

    Returns:
        (count, D).

    Raises:
        SearchError: the sampling is unknown, or there are fewer than two points.
    """
    check_counts(points=count)
    size = len(bounds.lower)
    if sampling == "uniform":
        unit = rng.random((count, size))
    elif sampling == "latin_hypercube":
        unit = qmc.LatinHypercube(size, rng=rng).random(count)
    else:
        raise SearchError(f"sampling: {sampling!r} is unknown: it must be one of {', '.join(SAMPLINGS)}")
    return bounds.from_unit(unit)


def study(
    executor: Evaluator,
    bounds: ParameterBounds,
    *,
    points: int = 500,
    seed: int = 1,
    sampling: str = "uniform",
    progress: ProgressCallback | None = None,
) -> tuple[PrincipalComponents, NDArray[np.float64]]:
    """Fly random points, each once and on its own seed, and analyse their fitnesses as the paper does.

    Args:
        executor: evaluator of the flights.
        bounds: bounds of the points.
        points: number of points.
        seed: seed from which the points and the seeds of their flights are drawn.
        sampling: see `random_points`.
        progress: called after each flight.

    Returns:
        The components and the fitnesses (points, 6).

    Raises:
        SearchError: see `random_points`; or a flight failed, whose fitness of 0 would bias the components.
    """
    rng = np.random.default_rng(seed)
    chosen = random_points(bounds, points, rng, sampling)
    seeds = rng.integers(1, 2**31, (points, 1))
    flown = evaluate_batch(executor, [bounds.params(point) for point in chosen], seeds.tolist(), progress)
    if flown.failed.any():
        raise SearchError(f"points: {int(flown.failed.sum())} of {points} flights failed; it must be none")
    fitness = flown.fitness[:, 0]
    return fitness_components(fitness), fitness


def principal_components(
    values: NDArray[np.float64], names: Sequence[str], *, rising: str | None = None
) -> PrincipalComponents:
    """Standardise variables and compute their principal components.

    Args:
        values: (n, M), one sample per row.
        names: (M,), names of the variables.
        rising: the variable whose weight is made positive in each component. The largest weight is made positive if
            `rising` is None or its weight is 0. (The sign of a component is arbitrary.)

    Raises:
        SearchError: there are fewer than two samples, a value is not finite, or all variables are constant.
    """
    if len(values) < 2:
        raise SearchError(f"samples: {len(values)} are too few: it must be at least 2")
    if not np.isfinite(values).all():
        raise SearchError(f"{names[int(np.argmin(np.isfinite(values).all(axis=0)))]}: a value is not a finite number")
    scaler = StandardScaler().fit(values)
    varies = np.ptp(values, axis=0) > 0
    if not varies.any():
        raise SearchError(f"{', '.join(names)}: none of them varies over the samples; it must be at least 1")
    standard = np.where(varies, scaler.transform(values), 0.0)
    fitted = PCA(n_components=min(standard.shape)).fit(standard)
    anchor = list(names).index(rising) if rising else -1
    return PrincipalComponents(
        names=tuple(names),
        samples=len(values),
        mean=np.asarray(scaler.mean_),
        deviation=np.sqrt(scaler.var_),
        covariance=np.cov(standard, rowvar=False),
        components=np.array([_oriented(component, anchor) for component in fitted.components_]),
        explained=np.asarray(fitted.explained_variance_ratio_),
    )


def _oriented(component: NDArray[np.float64], anchor: int) -> NDArray[np.float64]:
    """Component with its sign chosen so that the weight of variable `anchor` is positive; -1 for the largest weight."""
    decisive = component[anchor] if anchor >= 0 and abs(component[anchor]) > 1e-9 else 0.0
    decisive = decisive or component[np.argmax(np.abs(component))]
    return np.asarray(component * np.sign(decisive))


def fitness_components(fitness: NDArray[np.float64]) -> PrincipalComponents:
    """Components of the six fitnesses (n, 6), one flight per row; the weight of the speed is positive."""
    return principal_components(fitness, FITNESS_NAMES, rising="speed")


def grouped_by_sign(found: PrincipalComponents, scenario: Scenario | None = None) -> Objectives:
    """Two objectives: the fitnesses with positive and those with negative weight in the first component.

    A constant fitness is put into the second objective: a constant factor changes no comparison.

    Args:
        found: components of the six fitnesses.
        scenario: the scenario for which they were found.

    Raises:
        SearchError: all weights have the same sign.
    """
    first = tuple(name for name, weight in zip(found.names, found.components[0], strict=True) if weight > 0)
    second = tuple(name for name in found.names if name not in first)
    if set(first) <= set(found.constant) or set(second) <= set(found.constant):
        raise SearchError("first component: all weights have one sign; it must be two signs for two objectives")
    return Objectives(groups=(first, second), names=("F_1", "F_2"), scenario=scenario)


class Agreement(NamedTuple):
    """Agreement of components with the paper's.

    Attributes:
        cosine: absolute cosine of the angle between the two first components.
        same_signs: whether the weight of every fitness has the paper's sign.
        covariance_error: mean absolute difference of the 36 elements of the covariance.
    """

    cosine: float
    same_signs: bool
    covariance_error: float


def agreement(found: PrincipalComponents) -> Agreement:
    """Compare components of the six fitnesses with the paper's."""
    first = found.components[0]
    cosine = float(first @ FIRST_COMPONENT / np.linalg.norm(FIRST_COMPONENT))
    return Agreement(
        cosine=abs(cosine),
        same_signs=bool(np.all(np.sign(first) * np.sign(cosine) == np.sign(FIRST_COMPONENT))),
        covariance_error=float(np.mean(np.abs(found.covariance - COVARIANCE))),
    )
