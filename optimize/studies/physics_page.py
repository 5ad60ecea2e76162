"""What the front on physics looks like: its page and its figure."""

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
"""Searches on bodies: as they are, screened on point masses, and screened from the front found on point masses."""

_POINT_MASS, _TOGETHER = "found on point masses", "found on bodies in all searches"
_JUDGED = "the promising and safe of all searches on bodies, on other seeds"
_NAMES = {
    PLAIN: "found on bodies",
    SCREENED: "found on bodies, screened",
    REFINED: "found on bodies, screened, from that on point masses",
}
_STYLES = {PLAIN: (BLUE, "o"), SCREENED: (GREEN, "D"), REFINED: (PINK, "^")}


class Fronts(NamedTuple):
    """Fronts of several searches; all but the first on bodies, on the same fresh seeds.

    Attributes:
        found_there: on point masses, where it was found.
        point_mass: its points on bodies.
        searched: of each search on bodies, by its kind, of KINDS.
    """

    found_there: ReevaluatedFront
    point_mass: ReevaluatedFront
    searched: dict[str, tuple[ReevaluatedFront, ...]]


class Volume(NamedTuple):
    """A hypervolume and half the width of its 95 % confidence interval."""

    mean: float
    half_width: float

    def __str__(self) -> str:
        return f"{self.mean:.3f} +- {self.half_width:.3f}"


class Flights(NamedTuple):
    """What a search flies.

    Attributes:
        bodies: how many, in each search.
        point_masses: how many besides, in each screened search.
        response: of these point masses.
    """

    bodies: int
    point_masses: int
    response: PointMassConfig


def render_physics_page(fronts: Fronts, flights: Flights, judged: Validation, best: int | None) -> str:
    """The page, in Markdown.

    Args:
        fronts: of the study.
        flights: of its searches.
        judged: the most promising points.
        best: number of the one of these that is named; None if none is flyable.
    """
    scenario, seeds = fronts.point_mass.scenario, len(fronts.point_mass.seeds)
    runs, response = len(fronts.searched[REFINED]), flights.response
    together = together_front(fronts)
    kinds = {_POINT_MASS: (fronts.point_mass,)} | {_NAMES[kind]: some for kind, some in fronts.searched.items()}
    kinds[_TOGETHER] = (together,)
    kinds[_JUDGED] = (front_on_bodies(judged),)
    rows = [
        (name, str(hypervolumes(some)), *_best(some), str(sum(len(front.remaining) for front in some)))
        for name, some in kinds.items()
    ]
    head = ("front", "hypervolume on bodies", "best F_1", "best F_2", "F_1 at the knee", "F_2 at the knee", "points")
    there = fronts.found_there
    return (
        "\n\n".join(
            [
                "# The front on physics",
                f"Written by `make physics`: {scenario.drones} drones ({scenario.airframe}), {scenario.duration:g} s, "
                f"{runs} search{'es' * (runs > 1)} of each kind with {flights.bodies} "
                "flights of bodies each. The point masses that screen are calibrated: "
                f"tau {response.tau:.3g} s, a_max {response.a_max:.3g} m/s^2, delay {response.delay:.3g} s. "
                f"A screened search has {flights.point_masses} flights on point masses besides. The last kind begins "
                f"with the {len(fronts.point_mass.points)} points of the first front. All points were flown "
                f"again on bodies on {seeds} fresh seeds, the same for all. Where there are several searches of a "
                "kind, figures are means over them.",
                markdown(head, rows),
                f"On point masses, where it was found, the first front has the hypervolume {there.hypervolume:.3f} "
                f"({len(there.seeds)} seeds).",
                "\n".join(f"- {line}" for line in _differences(fronts)),
                f"The last {len(judged.names)} points are those below that were validated. Intervals are 95 %, by the "
                "jackknife over the seeds (Tukey 1958); they hold for these searches, and do not tell how far another "
                "search of the same kind would end from them.",
                f"![The fronts]({_FIGURE})",
                "## The front on bodies",
                f"What remains of all points {_TOGETHER}, best F_1 first. Of many that are flown the lucky lead: "
                "some of its hypervolume is luck. `moflock pick` and `moflock validate` take searches' directories.",
                _points_table(together),
                "## Which are safe to fly",
                f"Of all points that the searches flew, the {len(judged.names)} most promising of those that kept all "
                "limits, and twice the separation, in their few flights, validated on "
                f"{len(judged.settings.seeds)} seeds that none of them has flown. {_named(judged, best)}",
                _verdicts_table(judged),
            ]
        )
        + "\n"
    )


def hypervolumes(fronts: Sequence[ReevaluatedFront]) -> Volume:
    """Mean hypervolume of fronts on the same seeds."""
    values = np.mean([_pseudovalues(front) for front in fronts], axis=0)
    return Volume(float(np.mean([front.hypervolume for front in fronts])), float(half_width(values, axis=0)))


def difference(first: Sequence[ReevaluatedFront], second: Sequence[ReevaluatedFront]) -> Volume:
    """By how much the mean hypervolume of some fronts is above that of others on the same seeds."""
    values = [np.mean([_pseudovalues(front) for front in fronts], axis=0) for fronts in (first, second)]
    mean = [np.mean([front.hypervolume for front in fronts]) for fronts in (first, second)]
    return Volume(float(mean[0] - mean[1]), float(half_width(values[0] - values[1], axis=0)))


def _pseudovalues(front: ReevaluatedFront) -> NDArray[np.float64]:
    """The jackknife's pseudovalues (S,) of the hypervolume: what each seed has contributed to it."""
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
    pairs += [(_TOGETHER + "; less " + _POINT_MASS, (together_front(fronts),), there)]
    pairs += [(f"{_NAMES[kind]}; less {_POINT_MASS}", some, there) for kind, some in fronts.searched.items()]
    return [f"hypervolume, {name}: {difference(first, second)}" for name, first, second in pairs]


def together_front(fronts: Fronts) -> ReevaluatedFront:
    """The points of all searches on bodies as one front."""
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


def _named(judged: Validation, best: int | None) -> str:
    if best is None:
        return "None is safe enough to be named."
    return f"{judged.names[best]} is the named point `{NAMED}`: {RULE}."


def _verdicts_table(judged: Validation) -> str:
    mean, width = (of(judged.objectives[RIGID_BODY], axis=1) for of in (np.mean, half_width))
    rows = [
        (judged.names[number], *(f"{mean[number, k]:.3f} +- {width[number, k]:.3f}" for k in range(2)), *verdict)
        for number, verdict in sorted(enumerate(judged.verdicts), key=lambda pair: -mean[pair[0], 0])
    ]
    return markdown(("point", "F_1", "F_2", "verdict", "what decides"), rows)


def fronts_figure(fronts: Fronts, judged: Validation) -> Figure:
    """The fronts on bodies, and the first one where it was found; bars are 95 % confidence intervals."""
    figure = new_figure(8.4, 6.4)
    axes = figure.add_subplot()
    there = fronts.found_there.mean[fronts.found_there.remaining]
    axes.plot(*there.T, ".--", color=GREY, lw=1.0, ms=4, label="found on point masses, flown on these", zorder=1)
    _draw(axes, (fronts.point_mass,), ORANGE, "s", "found on point masses, flown on bodies")
    for kind, some in fronts.searched.items():
        _draw(axes, some, *_STYLES[kind], _NAMES[kind])
    _draw(axes, (front_on_bodies(judged),), BLACK, "v", _JUDGED)
    axes.set(xlabel="F_1", ylabel="F_2")
    seeds = len(fronts.point_mass.seeds)
    axes.set_title(f"Mean of {seeds} fresh seeds, {fronts.point_mass.scenario.duration:g} s")
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()  # the bars of few seeds reach beyond what can be
    axes.set(xlim=(max(left, -0.02), min(right, 1.02)), ylim=(max(low, -0.02), min(high, 1.02)))
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def _draw(axes: Axes, fronts: Sequence[ReevaluatedFront], colour: str, marker: str, label: str) -> None:
    """Each front as a line with bars, and faintly what it dominates."""
    for number, front in enumerate(fronts):
        kept = front.remaining
        mean, width = front.mean[kept], front.half_width[kept]
        style: dict[str, Any] = {"color": colour, "marker": marker, "ms": 5, "mec": "white", "zorder": 3}
        line = ("solid", (0, (5, 2)), (0, (1, 1.2)))[number % 3]
        axes.errorbar(*mean.T, *width.T[::-1], ls="none", elinewidth=0.7, ecolor=colour, alpha=0.5, zorder=2)
        axes.plot(*mean.T, ls=line, lw=1.5, label=label if number == 0 else None, **style)
        lesser = np.setdiff1d(np.arange(len(front.points)), kept)
        axes.plot(*front.mean[lesser].T, ls="none", color=colour, marker=marker, ms=3, alpha=0.35, zorder=1)
