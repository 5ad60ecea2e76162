"""Figures of a sensitivity study."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure, SubFigure

from controllers.policies.registry import spec_of, values_of
from moflock_mj.visualization.figure_style import BLACK, BLUE, GREEN, GREY, ORANGE, PINK, RED
from optimize.analysis.sensitivity import OneAtATime, SobolIndices, Sweep
from optimize.analysis.statistics import half_width
from optimize.evaluation.objectives import FITNESS_NAMES
from optimize.reports.figures import new_figure

_COLOURS = (RED, BLUE, GREEN, BLACK, PINK, ORANGE)


def sensitivity_figure(found: SobolIndices, along: OneAtATime, point: NamedTuple) -> Figure:
    """Sobol indices (top) and fitnesses along one parameter at a time (bottom)."""
    figure = new_figure(12.0, 14.2)
    halves = figure.add_gridspec(2, 1)
    _draw_indices(figure.add_subfigure(halves[0]), found, spec_of(point).names)
    _draw_along(figure.add_subfigure(halves[1]), along, point)
    return figure


def _draw_indices(figure: SubFigure, found: SobolIndices, names: Sequence[str]) -> None:
    """Draw first-order and total indices as heat maps, with the half width of their 95 % confidence intervals."""
    panels = figure.subplots(2, 1, sharex=True)
    pairs = (
        (found.first, found.first_width, "First-order Sobol indices"),
        (found.total, found.total_width, "Total Sobol indices"),
    )
    for axes, (values, widths, title) in zip(panels, pairs, strict=True):
        image = axes.imshow(values, cmap="YlGnBu", vmin=0, vmax=1, aspect="auto")
        for (row, column), value in np.ndenumerate(values):
            ink = "white" if value > 0.6 else BLACK
            text = f"{value:.2f}\n±{widths[row, column]:.2f}" if np.isfinite(value) else "-"
            axes.text(column, row, text, ha="center", va="center", fontsize=7, color=ink)
        axes.set_yticks(range(len(FITNESS_NAMES)), [f"F_{name}" for name in FITNESS_NAMES])
        axes.set_xticks(range(len(names)), names, rotation=30)
        axes.grid(False)
        axes.set_title(f"{title} ({found.points} points)")
        figure.colorbar(image, ax=axes, shrink=0.9, label="share of the variance")


def _draw_along(figure: SubFigure, found: OneAtATime, point: NamedTuple) -> None:
    """Draw all fitnesses along each parameter, mean and 95 % confidence interval over the seeds; dashed: the point."""
    parameters, values = spec_of(point).parameters, list(values_of(point).values())
    grid = figure.subplots(-(-len(parameters) // 4), 4, sharey=True, squeeze=False)
    mean, width = found.fitness.mean(axis=2), half_width(found.fitness, axis=2)
    for number, (parameter, axes) in enumerate(zip(parameters, grid.flat, strict=False)):
        for k, (fitness, colour) in enumerate(zip(FITNESS_NAMES, _COLOURS, strict=True)):
            low, high = mean[number, :, k] - width[number, :, k], mean[number, :, k] + width[number, :, k]
            axes.fill_between(found.values[number], low, high, color=colour, alpha=0.12, lw=0)
            axes.plot(found.values[number], mean[number, :, k], color=colour, lw=1.3, label=f"F_{fitness}")
        axes.axvline(values[number], color=GREY, ls=(0, (5, 3)), lw=1)
        axes.set(ylim=(-0.03, 1.03))
        axes.set_title(parameter.label)
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=6)


def sweep_figure(found: Sweep, unit: str) -> Figure:
    """All fitnesses over a field of the scenario, mean and 95 % confidence interval over the seeds."""
    figure = new_figure(7.2, 4.6)
    axes = figure.add_subplot()
    mean, width = found.fitness.mean(axis=1), half_width(found.fitness, axis=1)
    for k, (fitness, colour) in enumerate(zip(FITNESS_NAMES, _COLOURS, strict=True)):
        axes.errorbar(
            found.values, mean[:, k], width[:, k], fmt="o-", color=colour, lw=1.3, ms=4, capsize=2, label=f"F_{fitness}"
        )
    axes.set(ylim=(-0.03, 1.03), xlabel=f"{found.field}, {unit}" if unit != "1" else found.field)
    axes.set_title(f"Mean over {found.fitness.shape[1]} seeds with 95 % confidence intervals")
    figure.legend(loc="outside lower center", ncols=6)
    return figure
