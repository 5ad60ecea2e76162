"""Page of the reproduction of the paper's study, `docs/reproduction.md`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moflock_mj.analysis.target_tracking import TargetResult
from optimize.analysis.pca import Agreement
from optimize.analysis.published_results import COVARIANCE, FIRST_COMPONENT, PAPER_RESULTS
from optimize.evaluation.coverage import CELL, SIGHT
from optimize.evaluation.objectives import FITNESS_NAMES
from optimize.reports.tables import markdown
from optimize.search.findings import Findings
from optimize.search.front import ReevaluatedFront, best_with, knee
from optimize.studies.comparison import Score

_MIN_SHARE = 0.7
"""Least mean of the other objective for the points `fast` and `cohesive`, and of both for `knee`."""


class Single(NamedTuple):
    """Best point of a single-objective search, flown on fresh seeds.

    Attributes:
        params: the point.
        fitness: (S, 7), fitness of each flight, with coverage.
        seed: first of the seeds.
    """

    params: NamedTuple
    fitness: NDArray[np.float64]
    seed: int


class Study(NamedTuple):
    """Content of the page.

    Attributes:
        found: findings of the main search.
        analyses: agreement of principal components on several seeds with the paper's.
        scores: scores of the searches with equal budgets, by name.
        budget: number of flights of each search.
        fresh: number of fresh seeds on which the searches are compared.
        singles: best points of CMA-ES within bounds, without bounds, and without bounds but with coverage, by name.
        tracked: target-tracking flights of A and B, by name.
    """

    found: Findings
    analyses: Sequence[Agreement]
    scores: Mapping[str, Score]
    budget: int
    fresh: int
    singles: Mapping[str, Single]
    tracked: Mapping[str, Sequence[TargetResult]]


def named_points(front: ReevaluatedFront) -> dict[str, tuple[int, str]]:
    """Index on the front of each named point, and the rule by which it is chosen."""
    first, last = front.objectives.names[0], front.objectives.names[-1]
    return {
        "fast": (
            best_with(front, 0, kept=1, least=_MIN_SHARE),
            f"best mean {first} with a mean {last} of {_MIN_SHARE} or more",
        ),
        "knee": (_useful_knee(front), f"knee of the front where both means are {_MIN_SHARE} or more"),
        "cohesive": (
            best_with(front, 1, kept=0, least=_MIN_SHARE),
            f"best mean {last} with a mean {first} of {_MIN_SHARE} or more",
        ),
    }


def _useful_knee(front: ReevaluatedFront) -> int:
    """Index of the knee among the points with both means of at least `_MIN_SHARE`, or else of the whole front."""
    useful = front.remaining[(front.mean[front.remaining] >= _MIN_SHARE).all(axis=1)]
    return int(useful[knee(front.mean[useful])]) if useful.size else front.knee


def render_paper_page(study: Study) -> str:
    """Render the page in Markdown."""
    return (
        "\n\n".join(
            [
                "# Reproduction of the paper's study",
                "This page is written by `make paper`; all numbers are from that run, unless they are marked as the "
                "paper's. The full report with all figures is [reproduction/index.html](reproduction/index.html).",
                _components_section(study.found, study.analyses),
                _front_section(study.found),
                _comparison_section(study.scores, study.budget, study.fresh),
                _unbounded_section(study.singles),
                _target_section(study.tracked),
            ]
        )
        + "\n"
    )


def _components_section(found: Findings, analyses: Sequence[Agreement]) -> str:
    components = found.components
    assert components is not None  # for the type checker: `reproduce` has just written them
    rows = [
        (f"F_{name}", f"{here:.3f}", f"{paper:.3f}")
        for name, here, paper in zip(FITNESS_NAMES, components.components[0], FIRST_COMPONENT, strict=True)
    ]
    matrix = [
        (f"F_{name}", *(f"{here:.2f} ({paper:.2f})" for here, paper in zip(row, paper_row, strict=True)))
        for name, row, paper_row in zip(FITNESS_NAMES, components.covariance, COVARIANCE, strict=True)
    ]
    difference = np.abs(components.covariance - COVARIANCE).mean(axis=1)
    farthest = int(np.argmax(difference))
    seeds = [
        (str(seed), f"{near.cosine:.3f}", "yes" if near.same_signs else "no", f"{near.covariance_error:.3f}")
        for seed, near in enumerate(analyses, start=1)
    ]
    return "\n\n".join(
        [
            "## Principal components",
            f"{components.samples} random points, with MOflock's initial state. First component:",
            markdown(("", "here", "paper"), rows),
            "Covariance, with the paper's in brackets:",
            markdown(("", *(f"F_{name}" for name in FITNESS_NAMES)), matrix),
            "Agreement with the paper on several seeds:",
            markdown(
                ("seed", "cosine of the first components", "same signs", "mean difference of the covariance"), seeds
            ),
            f"The covariances of F_{FITNESS_NAMES[farthest]} differ most from the paper's: by "
            f"{difference[farthest]:.2f} on average.",
            "![Principal components](reproduction/pca.png)",
        ]
    )


def _front_section(found: Findings) -> str:
    front, marks = found.front, found.landmarks
    rows: list[tuple[str, ...]] = [
        (f"{name}, from the paper's table", f"{r.F_1[0]:.3f} ± {r.F_1[1]:.3f}", f"{r.F_2[0]:.3f} ± {r.F_2[1]:.3f}")
        for name, r in PAPER_RESULTS.items()
    ]
    rows += [(f"{name}, flown here", *_cells(marks, number)) for number, name in enumerate(found.landmark_names)]
    rows += [(f"`{name}`: {rule}", *_cells(front, number)) for name, (number, rule) in named_points(front).items()]
    rows += [("best F_1", *_cells(front, front.best(0))), ("best F_2", *_cells(front, front.best(-1)))]
    return "\n\n".join(
        [
            "## Front",
            f"The search has made {found.evaluations[0]} evaluations. Its front on {len(front.seeds)} fresh seeds has "
            f"{len(front.remaining)} points and a hypervolume of {front.hypervolume:.3f}. Mean ± standard deviation "
            "over the flights:",
            markdown(("point", *front.objectives.names), rows),
            "In these flights, drones start separated and at rest. In MOflock, they start with a common velocity, "
            "which raises correlation and connection, and so F_2, for points with weak alignment, such as A.",
            "![Front](reproduction/front.png)",
            "![Estimated fronts](reproduction/generations.png)",
            "![Order parameters](reproduction/order_parameters.png)",
        ]
    )


def _comparison_section(scores: Mapping[str, Score], budget: int, fresh: int) -> str:
    rows = [
        (
            name,
            ", ".join(f"{volume:.3f}" for volume in score.hypervolume),
            f"{score.hypervolume.mean():.3f}",
            f"{score.product.mean():.3f}",
            *(f"{best:.3f}" for best in score.best.mean(axis=0)),
        )
        for name, score in scores.items()
    ]
    means = {name: float(score.hypervolume.mean()) for name, score in scores.items()}
    best = max(means, key=lambda name: means[name])
    within = max(float(np.ptp(score.hypervolume)) for score in scores.values())
    runs = max(len(score.hypervolume) for score in scores.values())
    return "\n\n".join(
        [
            "## Searches with equal budgets",
            f"Each search has {budget} flights and is run {runs} times. The best points of each run are then flown on "
            f"{fresh} fresh seeds, which are the same for the points of a run. The reference point of the hypervolume "
            "is (0, 0). CMA-ES and PSO maximise the product of all six fitnesses and do not search for a front.",
            markdown(("search", "hypervolume of each run", "mean", "best product", "best F_1", "best F_2"), rows),
            "With one fixed seed, as in the paper, the errors of all points are correlated, and only fresh seeds show "
            "the true objectives of the front. The other searches use a new seed for each evaluation, fly the leaders "
            "again, and compare points by a Gaussian process over all flights. The genetic algorithms also use it to "
            "select one of four offspring for each flight.",
            f"{best} has the highest mean hypervolume, {means[best]:.3f}, and the lowest is {min(means.values()):.3f}. "
            f"Runs of the same search differ by up to {within:.3f}.",
        ]
    )


def _unbounded_section(singles: Mapping[str, Single]) -> str:
    rows, shares = [], []
    for name, single in singles.items():
        fitness = dict(zip((*FITNESS_NAMES, "coverage"), single.fitness.mean(axis=0), strict=True))
        shares.append(f"{fitness['coverage']:.0%} {name}")
        product = single.fitness[:, :6].prod(axis=1).mean()
        rows.append((name, f"{product:.3f}", *(f"{value:.3f}" for value in fitness.values())))
    return "\n\n".join(
        [
            "## Without bounds",
            "Best points of CMA-ES, which maximises the product of the fitnesses, on fresh seeds. Coverage is the "
            f"share of the arena's {CELL:g} m cells that came within {SIGHT:g} m of a drone. The paper's search "
            "without bounds ended with a flock that circles in the middle of the arena. The mean coverage of the "
            f"flocks here is {', '.join(shares)}.",
            markdown(("search", "product", *(f"F_{name}" for name in FITNESS_NAMES), "coverage"), rows),
            "![Best point without bounds](reproduction/unbounded.png)",
        ]
    )


def _target_section(tracked: Mapping[str, Sequence[TargetResult]]) -> str:
    def median(values: Sequence[float]) -> str:
        return f"{float(np.median(values)):.4g}"

    def ratio(values: Mapping[str, Sequence[float]]) -> str:
        return f"{float(np.median(values['A']) / np.median(values['B'])):.2f}"

    amplitudes = {name: [result.sine.amplitude for result in results] for name, results in tracked.items()}
    frequencies = {name: [result.sine.omega for result in results] for name, results in tracked.items()}
    rows = [
        (
            name,
            median(amplitudes[name]),
            median(frequencies[name]),
            median([result.F_target for result in results]),
        )
        for name, results in tracked.items()
    ]
    return "\n\n".join(
        [
            "## Target in a corner",
            f"Medians of {len(tracked['A'])} flights:",
            markdown(("point", "amplitude, m", "omega, rad/s", "F_target, rad/(s m)"), rows),
            f"The amplitude of A is {ratio(amplitudes)} times that of B, and its frequency {ratio(frequencies)} times. "
            "In the paper, the less correlated flock has about half the amplitude and nearly twice the frequency of "
            "the other one. That passage calls it B; the rest of the paper, and this page, call it A.",
            "![Target](reproduction/target.png)",
        ]
    )


def _cells(front: ReevaluatedFront, number: int) -> tuple[str, ...]:
    pairs = zip(front.mean[number], front.deviation[number], strict=True)
    return tuple(f"{mean:.3f} ± {spread:.3f}" for mean, spread in pairs)
