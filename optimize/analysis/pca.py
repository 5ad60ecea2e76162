"""Principal components of the fitnesses: which of them rise together, and how they make objectives.

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
    """The components of M standardised variables.

    Attributes:
        names: of the variables.
        samples: how many rows there were.
        mean: (M,), of each variable before it was standardised.
        deviation: (M,), standard deviation of the same.
        covariance: (M, M), of the standardised variables, over samples - 1: its diagonal is samples / (samples - 1).
        components: (M, M), a unit vector in each row, that of the largest variance first.
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
        """Variables that never varied: they have no part in any component."""
        return tuple(name for name, own in zip(self.names, np.diag(self.covariance), strict=True) if own == 0)

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        facts = dataclasses.asdict(self)
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in facts.items()}


def load_components(path: str | Path) -> PrincipalComponents:
    """Read the components that a file has as its "pca": what `to_dict` gave.

    Raises:
        SearchError: the file cannot be read, or has none.
    """
    try:
        facts = json.loads(Path(path).read_text(encoding="utf-8"))["pca"]
        arrays = ("mean", "deviation", "covariance", "components", "explained")
        return PrincipalComponents(
            names=tuple(facts["names"]),
            samples=int(facts["samples"]),
            **{name: np.asarray(facts[name], np.float64) for name in arrays},
        )
    except OSError as problem:
        raise SearchError(f"pca {path}: {problem.strerror}") from None
    except (ValueError, KeyError, TypeError) as problem:
        raise SearchError(f"pca {path}: not a principal component analysis: {problem}") from None


def components_json(found: PrincipalComponents, objectives: Objectives) -> str:
    """The grouping as `load_objectives` reads it, with the analysis behind it as "pca"."""
    return json.dumps({**json.loads(objectives.to_json()), "pca": found.to_dict()}, indent=1) + "\n"


def random_points(
    bounds: ParameterBounds, count: int, rng: np.random.Generator, sampling: str = "uniform"
) -> NDArray[np.float64]:
    """Random points inside the bounds.

    Args:
        bounds: of the parameters.
        count: how many points.
        rng: random numbers.
        sampling: "uniform", or "latin_hypercube", one point in each slice of each axis (McKay, Beckman, Conover 1979).

    Returns:
        (count, D).

    Raises:
        SearchError: an unknown way, or too few points.
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
    told: ProgressCallback | None = None,
) -> tuple[PrincipalComponents, NDArray[np.float64]]:
    """Fly random points, once each and on a seed of its own, and analyse their fitnesses, as the paper does.

    Args:
        executor: flies.
        bounds: of the points.
        points: how many.
        seed: of the points and of their flights.
        sampling: see `random_points`.
        told: of progress.

    Returns:
        The components, and the fitnesses, (points, 6).

    Raises:
        SearchError: see `random_points`; or a flight failed, whose fitness would pass for a bad one.
    """
    rng = np.random.default_rng(seed)
    chosen = random_points(bounds, points, rng, sampling)
    seeds = rng.integers(1, 2**31, (points, 1))
    flown = evaluate_batch(executor, [bounds.params(point) for point in chosen], seeds.tolist(), told)
    if flown.failed.any():
        raise SearchError(f"points: {int(flown.failed.sum())} of {points} flights failed; must be none")
    fitness = flown.fitness[:, 0]
    return fitness_components(fitness), fitness


def principal_components(
    values: NDArray[np.float64], names: Sequence[str], *, rising: str | None = None
) -> PrincipalComponents:
    """Standardise variables and find their principal components.

    Args:
        values: (n, M), a sample in each row.
        names: of the M variables.
        rising: the variable whose weights count as positive; where it has none, and without it, each component's
            largest weight is positive. (A component is as good as its negative.)

    Raises:
        SearchError: fewer than two samples, a value that is not finite, or no variable that varies.
    """
    if len(values) < 2:
        raise SearchError(f"samples: {len(values)} are too few: it must be at least 2")
    if not np.isfinite(values).all():
        raise SearchError(f"{names[int(np.argmin(np.isfinite(values).all(axis=0)))]}: a value is not a finite number")
    scaler = StandardScaler().fit(values)
    varies = np.ptp(values, axis=0) > 0
    if not varies.any():
        raise SearchError(f"{', '.join(names)}: none of them varies over the samples; must be at least one")
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
    """The component or its negative; anchor: the variable whose weight is to be positive, or -1."""
    decisive = component[anchor] if anchor >= 0 and abs(component[anchor]) > 1e-9 else 0.0
    decisive = decisive or component[np.argmax(np.abs(component))]
    return np.asarray(component * np.sign(decisive))


def fitness_components(fitness: NDArray[np.float64]) -> PrincipalComponents:
    """The components of the six fitnesses, (n, 6), a flight in each row; the weight of the speed is positive."""
    return principal_components(fitness, FITNESS_NAMES, rising="speed")


def grouped_by_sign(found: PrincipalComponents, scenario: Scenario | None = None) -> Objectives:
    """Two objectives: the fitnesses of positive and those of negative weight in the first component.

    A fitness that never varied is put into the second: as a constant factor it changes no comparison.

    Args:
        found: of the six fitnesses.
        scenario: for which they were found.

    Raises:
        SearchError: all weights have one sign, so that there is one group only.
    """
    first = tuple(name for name, weight in zip(found.names, found.components[0], strict=True) if weight > 0)
    second = tuple(name for name in found.names if name not in first)
    if set(first) <= set(found.constant) or set(second) <= set(found.constant):
        raise SearchError("first component: all weights have one sign; must be two for two objectives")
    return Objectives(groups=(first, second), names=("F_1", "F_2"), scenario=scenario)


class Agreement(NamedTuple):
    """How near our components are to the paper's.

    Attributes:
        cosine: of the angle between the two first components, without its sign.
        same_signs: whether every fitness has the paper's sign.
        covariance_error: mean absolute difference of the covariance's 36 elements.
    """

    cosine: float
    same_signs: bool
    covariance_error: float


def agreement(found: PrincipalComponents) -> Agreement:
    """Compare the components of the six fitnesses with the paper's."""
    first = found.components[0]
    cosine = float(first @ FIRST_COMPONENT / np.linalg.norm(FIRST_COMPONENT))
    return Agreement(
        cosine=abs(cosine),
        same_signs=bool(np.all(np.sign(first) * np.sign(cosine) == np.sign(FIRST_COMPONENT))),
        covariance_error=float(np.mean(np.abs(found.covariance - COVARIANCE))),
    )
