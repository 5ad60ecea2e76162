"""`docs/reproduction.md`: the paper's study as flown here, in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moflock_mj.analysis.target_tracking import TargetResult
from optimize.analysis.pca import Agreement
from optimize.analysis.published_results import COVARIANCE, FIRST_COMPONENT, PAPER_RESULTS
from optimize.evaluation.objectives import FITNESS_NAMES
from optimize.reports.tables import markdown
from optimize.search.findings import Findings
from optimize.search.front import ReevaluatedFront, best_with, knee
from optimize.studies import comparison
from optimize.studies.comparison import Score

_MIN_SHARE = 0.7
"""What `fast` keeps of the last objective and `cohesive` of the first: a flock that gives one up is no use."""


class Single(NamedTuple):
    """The best point of a single-objective search, as flown on fresh seeds.

    Attributes:
        params: the point.
        fitness: (S, 7), with coverage.
        seed: the first of the seeds.
    """

    params: NamedTuple
    fitness: NDArray[np.float64]
    seed: int


class Study(NamedTuple):
    """All that the page tells.

    Attributes:
        found: the main search's findings.
        analyses: principal components on several seeds, beside the paper's.
        scores: of the searches at equal budgets, by name.
        budget: flights of each.
        singles: the best point of CMA-ES within bounds, without, and without but with coverage, by name.
        tracked: flights of A and B around a target.
    """

    found: Findings
    analyses: Sequence[Agreement]
    scores: Mapping[str, Score]
    budget: int
    singles: Mapping[str, Single]
    tracked: Mapping[str, Sequence[TargetResult]]


def named_points(front: ReevaluatedFront) -> dict[str, tuple[int, str]]:
    """Of each named point its number on the front and the rule by which it is chosen."""
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
    """Number of the point at the knee of the part of the front that gives up neither objective."""
    useful = front.remaining[(front.mean[front.remaining] >= _MIN_SHARE).all(axis=1)]
    return int(useful[knee(front.mean[useful])]) if useful.size else front.knee


def render_paper_page(study: Study) -> str:
    """The page."""
    return (
        "\n\n".join(
            [
                "# The paper's study, flown here",
                "Written by `make paper`; every number below is from that run. The whole report, with all figures, is "
                "[reproduction/index.html](reproduction/index.html).",
                _components_section(study.found, study.analyses),
                _front_section(study.found),
                _comparison_section(study.scores, study.budget),
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
        (f"F_{name}", f"{ours:.3f}", f"{theirs:.3f}")
        for name, ours, theirs in zip(FITNESS_NAMES, components.components[0], FIRST_COMPONENT, strict=True)
    ]
    matrix = [
        (f"F_{name}", *(f"{ours:.2f} ({theirs:.2f})" for ours, theirs in zip(mine, papers, strict=True)))
        for name, mine, papers in zip(FITNESS_NAMES, components.covariance, COVARIANCE, strict=True)
    ]
    seeds = [
        (str(seed), f"{near.cosine:.3f}", "yes" if near.same_signs else "no", f"{near.covariance_error:.3f}")
        for seed, near in enumerate(analyses, start=1)
    ]
    return "\n\n".join(
        [
            "## Principal components",
            f"{components.samples} random points, from MOflock's start. First component:",
            markdown(("", "ours", "paper"), rows),
            "Covariance, ours (the paper's):",
            markdown(("", *(f"F_{name}" for name in FITNESS_NAMES)), matrix),
            "On several seeds:",
            markdown(("seed", "cosine", "same signs", "mean difference of covariance"), seeds),
            "The elements of F_coll differ most: the paper's collisions are tied closer to correlation and connection.",
            "![Principal components](reproduction/pca.png)",
        ]
    )


def _front_section(found: Findings) -> str:
    front, marks = found.front, found.landmarks
    rows: list[tuple[str, ...]] = [
        (f"{name}, the paper's table", f"{r.F_1[0]:.3f} ± {r.F_1[1]:.3f}", f"{r.F_2[0]:.3f} ± {r.F_2[1]:.3f}")
        for name, r in PAPER_RESULTS.items()
    ]
    rows += [(f"{name}, flown here", *_cells(marks, number)) for number, name in enumerate(found.landmark_names)]
    rows += [(f"our `{name}`: {rule}", *_cells(front, number)) for name, (number, rule) in named_points(front).items()]
    rows += [("our best F_1", *_cells(front, front.best(0))), ("our best F_2", *_cells(front, front.best(-1)))]
    return "\n\n".join(
        [
            "## Front",
            f"{found.evaluations[0]} evaluations; the front on {len(front.seeds)} fresh seeds has a hypervolume of "
            f"{front.hypervolume:.3f}, and {len(front.remaining)} points. Mean ± standard deviation from flight to "
            "flight:",
            markdown(("point", *front.objectives.names), rows),
            "Flights here start apart and at rest. MOflock's drones start with one common velocity, which lends "
            "correlation and connection (F_2) to points that hardly align by themselves, such as A.",
            "![Front](reproduction/front.png)",
            "![Last even fronts](reproduction/generations.png)",
            "![Order parameters](reproduction/order_parameters.png)",
        ]
    )


def _comparison_section(scores: Mapping[str, Score], budget: int) -> str:
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
    return "\n\n".join(
        [
            "## Searches at equal budgets",
            f"{budget} flights each, three runs; then the 50 points that a search believes in fly on "
            f"{comparison.SEEDS} fresh seeds, the same for all. Hypervolume from (0, 0); CMA-ES and PSO maximise the "
            "product of all six fitnesses and are no searches for a front.",
            markdown(("search", "hypervolume of each run", "mean", "best product", "best F_1", "best F_2"), rows),
            "One fixed seed is the paper's way: all points are lucky together with it, and only fresh seeds tell what "
            "its front is worth. The other searches give each evaluation a seed of its own, fly the leaders again, "
            "believe a regression over all flights rather than single ones, and let it choose which of four points "
            "bred is flown. Runs of one search differ by as much as searches do, so none proves better than NSGA-II, "
            "which stays the default.",
        ]
    )


def _unbounded_section(singles: Mapping[str, Single]) -> str:
    rows = []
    for name, single in singles.items():
        fitness = dict(zip((*FITNESS_NAMES, "coverage"), single.fitness.mean(axis=0), strict=True))
        product = single.fitness[:, :6].prod(axis=1).mean()
        rows.append((name, f"{product:.3f}", *(f"{value:.3f}" for value in fitness.values())))
    return "\n\n".join(
        [
            "## Without bounds",
            "CMA-ES on the product of six, its best point on fresh seeds. Coverage is the share of the arena's 10 m "
            "cells that came within 25 m of a drone. The paper's search without bounds ended in a flock that circles "
            "in the middle, which would cover little; ours crosses the arena, with coverage among the fitnesses more "
            "of it.",
            markdown(("search", "product", *(f"F_{name}" for name in FITNESS_NAMES), "coverage"), rows),
            "![Best point without bounds](reproduction/unbounded.png)",
        ]
    )


def _target_section(tracked: Mapping[str, Sequence[TargetResult]]) -> str:
    def median(values: Sequence[float]) -> str:
        return f"{float(np.median(values)):.4g}"

    rows = [
        (
            name,
            median([result.sine.amplitude for result in results]),
            median([result.sine.omega for result in results]),
            median([result.F_target for result in results]),
        )
        for name, results in tracked.items()
    ]
    return "\n\n".join(
        [
            "## Target in a corner",
            f"Medians of {len(tracked['A'])} flights:",
            markdown(("point", "amplitude, m", "omega, rad/s", "F_target, rad/(s m)"), rows),
            "As in the paper, the loosely correlated flock has about half the amplitude and nearly twice the "
            "frequency. The paper calls that flock B in this passage, and A everywhere else; here it is A.",
            "![Target](reproduction/target.png)",
        ]
    )


def _cells(front: ReevaluatedFront, number: int) -> tuple[str, ...]:
    pairs = zip(front.mean[number], front.deviation[number], strict=True)
    return tuple(f"{mean:.3f} ± {spread:.3f}" for mean, spread in pairs)
