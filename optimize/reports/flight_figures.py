"""Figures of single flights: order parameters over time, and target tracking."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from moflock_mj.analysis.target_tracking import TRANSIENT, TargetResult
from moflock_mj.metrics.catalogue import METRICS
from moflock_mj.metrics.samples import Samples
from moflock_mj.simulation.results import Flight
from moflock_mj.visualization.figure_style import BLACK, BLUE, GREY, RED
from moflock_mj.visualization.flight_figure import feasible_maxima
from optimize.reports.figures import new_figure


def order_parameters_figure(flights: Sequence[Flight], names: Sequence[str]) -> Figure:
    """Running order parameters of flights, relative to their feasible maxima; one panel per flight."""
    figure = new_figure(5.6 * len(flights), 4.4)
    row = np.atleast_1d(figure.subplots(1, len(flights), sharey=True))
    lowest = 0.0
    for axes, flight, name in zip(row, flights, names, strict=True):
        samples = _kept(flight)
        maxima, running = feasible_maxima(flight.scenario), samples.order_parameters
        for metric in METRICS:
            scaled = np.minimum(getattr(running, metric.key) / getattr(maxima, metric.key), 1.0)
            lowest = min(lowest, float(scaled.min()))
            axes.plot(samples.t, scaled, color=metric.colour, ls=metric.dashes, lw=1.6, label=metric.label)
        axes.set(xlabel="time, s", xlim=(0, samples.t[-1]))
        axes.set_title(f"{name}: F_1 = {flight.fitness.F_1:.2f}, F_2 = {flight.fitness.F_2:.2f}")
    row[0].set_ylim(1.05 * lowest - 0.03, 1.03)
    row[0].set_ylabel("running mean / feasible maximum")
    figure.legend(*row[0].get_legend_handles_labels(), loc="outside lower center", ncols=6)
    return figure


def target_figure(results: Sequence[TargetResult], names: Sequence[str]) -> Figure:
    """Distance to the target with the fitted sine, and trajectories of the last minute; one row per flock."""
    figure = new_figure(11.0, 3.3 * len(results))
    rows = figure.subplots(len(results), 2, width_ratios=(2.1, 1), squeeze=False)
    top = 1.05 * max(float(result.distance.max()) for result in results)
    for (left, right), result, name, colour in zip(rows, results, names, (BLUE, RED), strict=False):
        left.plot(result.t, result.distance, color=colour, lw=1.0, label="d_target")
        steady = result.t[result.t >= TRANSIENT]
        left.plot(steady, result.sine.at(steady), color=BLACK, lw=1.2, ls=(0, (5, 2)), label="fitted sine")
        left.axvspan(0, TRANSIENT, color=GREY, alpha=0.15, lw=0, label="transient, not fitted")
        left.set(xlabel="time, s", ylabel="distance to the target, m", xlim=(0, result.t[-1]), ylim=(0, top))
        left.legend(loc="upper right", ncols=3)
        sine = result.sine
        left.set_title(
            f"{name}: amplitude {sine.amplitude:.1f} m, omega {sine.omega:.3f} rad/s, "
            f"F_target {result.F_target:.4f} rad/(s m)"
        )
        _draw_last_minute(right, result, colour)
    return figure


def _draw_last_minute(axes: Axes, result: TargetResult, colour: str) -> None:
    """Draw the trajectories of the last minute, the arena and the target."""
    samples, arena = _kept(result.flight), result.flight.scenario.arena
    late = samples.t >= samples.t[-1] - 60
    paths = samples.position[late]
    axes.plot(paths[..., 0], paths[..., 1], color=colour, lw=0.5, alpha=0.5)
    axes.plot(*paths[-1, :, :2].T, "o", color=colour, ms=3)
    axes.plot(*result.target, "*", color=BLACK, ms=11, mec="white", label="target")
    axes.add_patch(Polygon(arena.outline(), fill=False, ec=GREY, lw=1.2))
    low = np.minimum(paths[..., :2].min(axis=(0, 1)), result.target) - 15
    high = np.maximum(paths[..., :2].max(axis=(0, 1)), result.target) + 15
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x, m", ylabel="y, m")
    axes.legend(loc="upper left")
    axes.set_title("Last minute, top view")


def _kept(flight: Flight) -> Samples:
    if flight.samples is None:
        raise ValueError("samples: the flight has none; it must be flown with keep_samples")
    return flight.samples
