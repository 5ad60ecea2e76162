"""Page and figure of the study of searches on rigid bodies, `docs/physics.md`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from controllers.policies.registry import POLICIES
from moflock_mj.scenario.effect_configs import PointMassConfig
from moflock_mj.visualization.figure_style import BLACK, BLUE, GREEN, GREY, ORANGE, PINK
from optimize.analysis.statistics import half_width
from optimize.reports.figures import new_figure
from optimize.reports.tables import markdown
from optimize.search.estimates import hypervolume
from optimize.search.front import ReevaluatedFront
from optimize.validation.flyable import NAMED, RULE, front_on_bodies
from optimize.validation.validation import RIGID_BODY, Validation

_FIGURE = "physics/fronts.png"

PLAIN, SCREENED, REFINED = KINDS = ("plain", "screened", "refined")
"""Kinds of searches on rigid bodies: unscreened, screened, and screened with a start from the point-mass front."""

_POINT_MASS, _UNION = "point-mass search", "union of all rigid-body searches"
_VALIDATED = "validated points, on other seeds"
_NAMES = {
    PLAIN: "rigid-body search",
    SCREENED: "rigid-body search, screened",
    REFINED: "rigid-body search, screened, from the point-mass front",
}
_STYLES = {PLAIN: (BLUE, "o"), SCREENED: (GREEN, "D"), REFINED: (PINK, "^")}


class Fronts(NamedTuple):
    """Fronts of several searches; all but the first are flown as rigid bodies, on the same fresh seeds.

    Attributes:
        found_there: front of the point-mass search, flown as point masses.
        point_mass: points of that front, flown as rigid bodies.
        searched: fronts of the searches on rigid bodies, by their kind, one of KINDS.
    """

    found_there: ReevaluatedFront
    point_mass: ReevaluatedFront
    searched: dict[str, tuple[ReevaluatedFront, ...]]


class Volume(NamedTuple):
    """Hypervolume with the half width of its 95 % confidence interval."""

    mean: float
    half_width: float

    def __str__(self) -> str:
        return f"{self.mean:.3f} +- {self.half_width:.3f}"


class Flights(NamedTuple):
    """Flights of a search.

    Attributes:
        bodies: number of rigid-body flights of each search.
        point_masses: number of point-mass flights of each screened search.
        response: response of these point masses.
    """

    bodies: int
    point_masses: int
    response: PointMassConfig


def render_physics_page(fronts: Fronts, flights: Flights, validated: Validation, best: int | None) -> str:
    """Render the page in Markdown.

    Args:
        fronts: fronts of the study.
        flights: flights of its searches.
        validated: validation of the most promising points.
        best: index of the named point among these; None if no point is flyable.
    """
    scenario, seeds = fronts.point_mass.scenario, len(fronts.point_mass.seeds)
    runs, response = len(fronts.searched[REFINED]), flights.response
    union = union_front(fronts)
    kinds = {_POINT_MASS: (fronts.point_mass,)} | {_NAMES[kind]: some for kind, some in fronts.searched.items()}
    kinds[_UNION] = (union,)
    kinds[_VALIDATED] = (front_on_bodies(validated),)
    rows = [
        (name, str(hypervolumes(some)), *_best(some), str(sum(len(front.remaining) for front in some)))
        for name, some in kinds.items()
    ]
    head = ("front", "hypervolume", "best F_1", "best F_2", "F_1 at the knee", "F_2 at the knee", "points")
    there = fronts.found_there
    return (
        "\n\n".join(
            [
                "# Searches on rigid bodies",
                f"This page is written by `make physics`: {scenario.drones} drones ({scenario.airframe}), "
                f"{scenario.duration:g} s, {runs} search{'es' * (runs > 1)} of each kind with {flights.bodies} "
                "rigid-body flights each. The point masses of the screening are calibrated: "
                f"tau {response.tau:.3g} s, a_max {response.a_max:.3g} m/s^2, delay {response.delay:.3g} s. "
                f"A screened search has {flights.point_masses} additional point-mass flights. The last kind of search "
                f"starts from {len(fronts.point_mass.points)} points of the front of the point-mass search. All points "
                f"were flown again as rigid bodies on {seeds} fresh seeds, which are the same for all. Values are "
                "means over the searches of a kind.",
                markdown(head, rows),
                f"Flown as point masses, the front of the point-mass search has a hypervolume of "
                f"{there.hypervolume:.3f} ({len(there.seeds)} seeds). Differences of the hypervolume:",
                "\n".join(f"- {line}" for line in _differences(fronts)),
                f"The last row has the {len(validated.names)} points of the validation below. Intervals are 95 % "
                "confidence intervals from a jackknife over the seeds (Tukey 1958). They do not include the variation "
                "between repeated searches of the same kind.",
                f"![Fronts]({_FIGURE})",
                "## Front on rigid bodies",
                f"Points of the {_UNION} that are not dominated, by decreasing F_1. The hypervolume of this front is "
                "biased upwards, because the best of many noisy means are selected. `moflock pick` and `moflock "
                "validate` take the directories of the searches.",
                _points_table(union),
                "## Validation",
                f"The {len(validated.names)} most promising points that kept all limits, and twice the least "
                "separation, in their flights during the searches were validated on "
                f"{len(validated.settings.seeds)} other seeds. {_named(validated, best)}",
                _verdicts_table(validated),
            ]
        )
        + "\n"
    )


def hypervolumes(fronts: Sequence[ReevaluatedFront]) -> Volume:
    """Mean hypervolume of fronts on the same seeds, with its confidence interval."""
    values = np.mean([_pseudovalues(front) for front in fronts], axis=0)
    return Volume(float(np.mean([front.hypervolume for front in fronts])), float(half_width(values, axis=0)))


def difference(first: Sequence[ReevaluatedFront], second: Sequence[ReevaluatedFront]) -> Volume:
    """Difference of the mean hypervolumes of two groups of fronts on the same seeds, with its confidence interval."""
    values = [np.mean([_pseudovalues(front) for front in fronts], axis=0) for fronts in (first, second)]
    mean = [np.mean([front.hypervolume for front in fronts]) for fronts in (first, second)]
    return Volume(float(mean[0] - mean[1]), float(half_width(values[0] - values[1], axis=0)))


def _pseudovalues(front: ReevaluatedFront) -> NDArray[np.float64]:
    """Jackknife pseudovalues (S,) of the hypervolume, one per seed."""
    values = front.values
    count = values.shape[1]
    without = [hypervolume(np.delete(values, seed, axis=1).mean(axis=1)) for seed in range(count)]
    return np.asarray(count * front.hypervolume - (count - 1) * np.array(without))


def _best(fronts: Sequence[ReevaluatedFront]) -> list[str]:
    best = np.mean([front.mean.max(axis=0) for front in fronts], axis=0)
    knee = np.mean([front.mean[front.knee] for front in fronts], axis=0)
    return [f"{value:.3f}" for value in (*best, *knee)]


def _differences(fronts: Fronts) -> list[str]:
    there = (fronts.point_mass,)
    pairs = [(f"{_NAMES[SCREENED]}; less unscreened", fronts.searched[SCREENED], fronts.searched[PLAIN])]
    pairs += [(f"{_UNION}; less {_POINT_MASS}", (union_front(fronts),), there)]
    pairs += [(f"{_NAMES[kind]}; less {_POINT_MASS}", some, there) for kind, some in fronts.searched.items()]
    return [f"{name}: {difference(first, second)}" for name, first, second in pairs]


def union_front(fronts: Fronts) -> ReevaluatedFront:
    """Points of all searches on rigid bodies as one front."""
    found = [front for some in fronts.searched.values() for front in some]
    return dataclasses.replace(
        found[0],
        points=np.concatenate([front.points for front in found]),
        fitness=np.concatenate([front.fitness for front in found]),
        failed=np.concatenate([front.failed for front in found]),
        origin={},
    )


def _points_table(front: ReevaluatedFront) -> str:
    rows = [(front.mean[number], front.half_width[number], front.points[number]) for number in front.remaining]
    words = [
        (*(f"{m:.3f} +- {h:.3f}" for m, h in zip(mean, width, strict=True)), *(f"{value:.4g}" for value in point))
        for mean, width, point in rows
    ]
    return markdown((*front.objectives.names, *POLICIES[front.policy].names), words)


def _named(validated: Validation, best: int | None) -> str:
    if best is None:
        return "None of them meets the rule for the named point."
    return f"{validated.names[best]} is the named point `{NAMED}`, chosen by the rule: {RULE}."


def _verdicts_table(validated: Validation) -> str:
    mean, width = (of(validated.objectives[RIGID_BODY], axis=1) for of in (np.mean, half_width))
    rows = [
        (validated.names[number], *(f"{mean[number, k]:.3f} +- {width[number, k]:.3f}" for k in range(2)), *verdict)
        for number, verdict in sorted(enumerate(validated.verdicts), key=lambda pair: -mean[pair[0], 0])
    ]
    return markdown(("point", "F_1", "F_2", "verdict", "reason"), rows)


def fronts_figure(fronts: Fronts, validated: Validation) -> Figure:
    """Fronts on rigid bodies, and the point-mass front with both dynamics; bars are 95 % confidence intervals."""
    figure = new_figure(8.4, 6.4)
    axes = figure.add_subplot()
    there = fronts.found_there.mean[fronts.found_there.remaining]
    axes.plot(*there.T, ".--", color=GREY, lw=1.0, ms=4, label="point-mass search, flown as point masses", zorder=1)
    _draw(axes, (fronts.point_mass,), ORANGE, "s", "point-mass search, flown as rigid bodies")
    for kind, some in fronts.searched.items():
        _draw(axes, some, *_STYLES[kind], _NAMES[kind])
    _draw(axes, (front_on_bodies(validated),), BLACK, "v", _VALIDATED)
    axes.set(xlabel="F_1", ylabel="F_2")
    seeds = len(fronts.point_mass.seeds)
    axes.set_title(f"Mean over {seeds} fresh seeds, {fronts.point_mass.scenario.duration:g} s")
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()  # with few seeds, the bars extend beyond [0, 1]
    axes.set(xlim=(max(left, -0.02), min(right, 1.02)), ylim=(max(low, -0.02), min(high, 1.02)))
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def _draw(axes: Axes, fronts: Sequence[ReevaluatedFront], colour: str, marker: str, label: str) -> None:
    """Draw each front as a line with bars, and its dominated points with small, pale markers."""
    for number, front in enumerate(fronts):
        kept = front.remaining
        mean, width = front.mean[kept], front.half_width[kept]
        style: dict[str, Any] = {"color": colour, "marker": marker, "ms": 5, "mec": "white", "zorder": 3}
        line = ("solid", (0, (5, 2)), (0, (1, 1.2)))[number % 3]
        axes.errorbar(*mean.T, *width.T[::-1], ls="none", elinewidth=0.7, ecolor=colour, alpha=0.5, zorder=2)
        axes.plot(*mean.T, ls=line, lw=1.5, label=label if number == 0 else None, **style)
        dominated = np.setdiff1d(np.arange(len(front.points)), kept)
        axes.plot(*front.mean[dominated].T, ls="none", color=colour, marker=marker, ms=3, alpha=0.35, zorder=1)
