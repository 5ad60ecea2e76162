"""Figure of a validation: the fronts with both dynamics, and arrows from point masses to rigid bodies."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from moflock_mj.metrics.verdict import FLYABLE, MARGINAL, UNSAFE
from moflock_mj.visualization.figure_style import BLACK, BLUE, GREEN, GREY, ORANGE, RED
from optimize.analysis.statistics import half_width
from optimize.reports.figures import new_figure
from optimize.validation.validation import POINT_MASS, RIGID_BODY, Validation

_COLOURS = {FLYABLE: GREEN, MARGINAL: ORANGE, UNSAFE: RED}


def fronts_figure(validation: Validation) -> Figure:
    """Mean F_1 and F_2 of each point with both dynamics and 95 % confidence intervals; colours show the verdicts."""
    figure = new_figure(8.2, 6.2)
    axes = figure.add_subplot()
    mean, width = validation.objectives.mean(axis=2), half_width(validation.objectives, axis=2)
    for dynamics, colour, label in (
        (POINT_MASS, BLUE, "front of point masses"),
        (RIGID_BODY, BLACK, "front of rigid bodies"),
    ):
        front = mean[dynamics, validation.on_front[dynamics]]
        front = front[np.argsort(front[:, 0])]
        axes.plot(front[:, 0], front[:, 1], color=colour, lw=1.2, ls=(0, (5, 3)), label=label, zorder=1)
    for number, name in enumerate(validation.names):
        start, end = mean[:, number]
        colour = _COLOURS[validation.verdicts[number].name]
        bars: dict[str, Any] = {"fmt": "none", "elinewidth": 0.9, "capsize": 2}
        axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": GREY, "lw": 1.1, "shrinkB": 4})
        axes.errorbar(*start, *width[POINT_MASS, number, ::-1], ecolor=BLUE, **bars)
        axes.errorbar(*end, *width[RIGID_BODY, number, ::-1], ecolor=colour, **bars)
        axes.plot(*start, "o", color=BLUE, ms=5, mec="white", zorder=3)
        axes.plot(*end, "D", color=colour, ms=7, mec="white", zorder=4)
        axes.annotate(name, end, (7, 5), textcoords="offset points", color=BLACK)
    axes.plot([], [], "o", color=BLUE, label="point mass")
    for verdict, colour in _COLOURS.items():
        axes.plot([], [], "D", color=colour, label=f"rigid body, {verdict}")
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()  # with few seeds, the bars extend beyond [0, 1]
    axes.set(xlim=(max(left, -0.02), min(right, 1.02)), ylim=(max(low, -0.02), min(high, 1.02)))
    axes.set(xlabel="F_1", ylabel="F_2")
    axes.set_title(f"From point mass to rigid body, mean over {len(validation.settings.seeds)} seeds")
    figure.legend(loc="outside lower center", ncols=3)
    return figure
