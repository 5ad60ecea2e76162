"""Figure of one flight or two: order parameters, trajectories from above, nearest distances, and speeds."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon
from matplotlib.transforms import ScaledTranslation
from numpy.typing import NDArray

from moflock_mj.errors import RenderError
from moflock_mj.files import new_file
from moflock_mj.metrics.catalogue import METRICS
from moflock_mj.metrics.order_parameters import TOUCHED, OrderParameters
from moflock_mj.metrics.samples import Samples
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulation.results import AnyFlight, kept_samples
from moflock_mj.visualization.captions import conditions, figures, flight_names
from moflock_mj.visualization.figure_style import BLACK, FLIGHTS, STYLE

FORMATS = (".png", ".svg", ".pdf")
"""File name extensions of the formats."""

_MAX_FLIGHTS = 2
_DOTS_PER_INCH = 150

_LIMIT = "#555555"
_DANGER = "#d00000"

_MAX_CORNERS = 1200
"""Maximum number of corners of one drone's trajectory; more are not distinguishable on the map."""

_TAIL_SECONDS = 15.0
"""Duration of the end of each trajectory that is drawn thicker, s."""


def feasible_maxima(scenario: Scenario) -> OrderParameters:
    """Values of the order parameters that are scaled to 1.

    For an order parameter to maximize, this is the largest value that a flight can reach. For one to minimize, it is a
    value with a low fitness: 0.02 for the wall, 0.04 for colliding pairs, 0.25 for isolated drones.
    """
    return OrderParameters(
        wall=2 * scenario.r_tol,
        vel=scenario.v_flock,
        corr=1.0,
        coll=4 * scenario.a_tol,
        disc=scenario.drones / 5,
        cluster=float(max(scenario.drones - 1, 1)),
    )


def save_flight_figure(flights: AnyFlight | Sequence[AnyFlight], out: str | os.PathLike[str]) -> None:
    """Save the figure of one flight, or of two side by side.

    Args:
        flights: one or two flights with samples.
        out: file to write, .png (150 dots per inch), .svg or .pdf.

    Raises:
        RenderError: no samples, more than two flights, an unknown format, or a file that cannot be written.
    """
    flights = list(flights) if isinstance(flights, Sequence) else [flights]
    form = Path(out).suffix.lower()
    if form not in FORMATS:
        raise RenderError(f"picture {out}: extension {form!r}: it must be one of {', '.join(FORMATS)}")
    if not 1 <= len(flights) <= _MAX_FLIGHTS:
        raise RenderError(f"flights: {len(flights)} given: there must be 1 to {_MAX_FLIGHTS}")
    with rc_context(STYLE), new_file(out) as place:
        undated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(form)
        flight_figure(flights).savefig(place, dpi=_DOTS_PER_INCH, metadata=undated)


@rc_context(STYLE)
def flight_figure(flights: Sequence[AnyFlight]) -> Figure:
    """Make the figure of one flight or two."""
    names = flight_names(flights)
    samples = [kept_samples(flight) for flight in flights]
    compared = len(flights) > 1
    figure = Figure(figsize=(12.5, 15 if compared else 10), layout="constrained")
    FigureCanvasAgg(figure)
    figure.get_layout_engine().set(hspace=0.04, wspace=0.05)  # type: ignore[union-attr, call-arg]
    rows = ["AB", "CD", "EF"] if compared else ["AC", "EF"]
    heights = [1.5, 1, 0.85] if compared else [1.3, 1]
    axes = figure.subplot_mosaic([list(row) for row in rows], height_ratios=heights)
    low, high = _bounds(flights[0].scenario, samples)
    for number, (flight, name) in enumerate(zip(flights, names, strict=True)):
        prefix, colour = (f"{name}: ", FLIGHTS[number]) if compared else ("", None)
        above, order = axes["AB"[number]], axes["CD"[number]]
        above.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x, m", ylabel="y, m")
        _draw_trajectories(above, flight.scenario, samples[number], colour)
        _draw_order_parameters(order, flight.scenario, samples[number])
        above.set_title(f"{prefix}Trajectories from above", color=colour or BLACK)
        order.set_title(f"{prefix}Order parameters, mean since the start", color=colour or BLACK)
    _draw_nearest(axes["E"], flights, samples, names)
    _draw_speeds(axes["F"], flights, samples, names)
    lines = [f"{name}: {conditions(flight)}\n{figures(flight)}" for name, flight in zip(names, flights, strict=True)]
    figure.suptitle("\n".join(lines), x=0.012, ha="left", fontsize=11, linespacing=1.4)
    return figure


def _bounds(scenario: Scenario, samples: list[Samples]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower left and upper right corner of the map, (2,), m: the arena and all trajectories, with a margin."""
    flown = [flight.position[..., :2].reshape(-1, 2) for flight in samples]
    corners = np.concatenate([scenario.arena.outline(), *flown])
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.03 * (high - low)
    return low - margin, high + margin


def _draw_trajectories(axes: Axes, scenario: Scenario, samples: Samples, colour: str | None) -> None:
    """Draw the trajectories of all drones from above, coloured by time; a compared flight has its own shades."""
    outline = scenario.arena.outline()
    axes.add_patch(Polygon(outline, closed=True, fill=False, edgecolor=_LIMIT, linewidth=1.4, zorder=1))
    # Viridis without its yellow end, which is too faint on paper; or grey to the flight's own colour.
    tones = colormaps["viridis"](np.linspace(0.85, 0, 64)) if colour is None else ["#d4d4d4", colour]
    shades = LinearSegmentedColormap.from_list("time", tones)
    every = max(1, -(-samples.t.size // _MAX_CORNERS))
    tail = samples.t >= samples.t[-1] - min(_TAIL_SECONDS, 0.25 * samples.t[-1])
    lines = _lines_in_time(samples.t[::every], samples.position[::every, :, :2], 0.7, 0.45, shades)
    lines.set_clim(samples.t[0], max(samples.t[-1], samples.t[0] + 1e-3))
    axes.add_collection(lines)
    ends = _lines_in_time(samples.t[tail], samples.position[tail, :, :2], 1.8, 1.0, shades)
    ends.set_clim(*lines.get_clim())
    axes.add_collection(ends)
    first, last = samples.position[0], samples.position[-1]
    tone = shades(1.0)
    axes.plot(first[:, 0], first[:, 1], "o", mfc="white", mec="#777777", ms=4, mew=0.9, zorder=4, label="start")
    axes.plot(last[:, 0], last[:, 1], "o", mfc=tone, mec="white", ms=6, mew=0.7, zorder=5, label="end")
    touches = _first_touches(samples)
    if len(touches):
        label = f"first contact ({len(touches)} drones)"
        axes.plot(touches[:, 0], touches[:, 1], "x", color=_DANGER, ms=8, mew=2, zorder=6, label=label)
    _legend_below(axes, 3)
    scale = ScalarMappable(lines.norm, shades)
    bar = axes.figure.colorbar(scale, cax=axes.inset_axes((1.03, 0.1, 0.03, 0.8)), label="time, s")
    bar.outline.set_visible(False)


def _lines_in_time(
    t: NDArray[np.float64], place: NDArray[np.float64], width: float, alpha: float, shades: Any
) -> LineCollection:
    """Trajectories of N drones as segments coloured by time; t: (T,), s; place: (T, N, 2), m."""
    pieces = np.stack([place[:-1], place[1:]], axis=2).reshape(-1, 2, 2)
    times = np.repeat(t[1:], place.shape[1])
    # As vector graphics, the segments of a long flight would need many megabytes.
    style: dict[str, Any] = {"linewidths": width, "alpha": alpha, "capstyle": "round", "rasterized": True, "zorder": 2}
    return LineCollection(list(pieces), array=times, cmap=shades, **style)


def _first_touches(samples: Samples) -> NDArray[np.float64]:
    """Position of each drone with a contact at its first sample in contact, (K, 3), m."""
    touched = (samples.status & TOUCHED) > 0
    drones = np.flatnonzero(touched.any(axis=0))
    return np.asarray(samples.position[touched.argmax(axis=0)[drones], drones])


def _draw_order_parameters(axes: Axes, scenario: Scenario, samples: Samples) -> None:
    """Draw the running order parameters, each relative to its feasible maximum."""
    maxima, running, lowest = feasible_maxima(scenario)._asdict(), samples.order_parameters._asdict(), 0.0
    for metric in METRICS:
        name = metric.key
        scaled = np.minimum(running[name] / maxima[name], 1.0)
        lowest = min(lowest, float(scaled.min()))
        value = f"{metric.label}: {running[name][-1]:.3g} of {maxima[name]:.3g} {metric.unit}".rstrip()
        axes.plot(samples.t, scaled, color=metric.colour, linestyle=metric.dashes, linewidth=1.6, label=value)
    axes.set(ylim=(min(-0.03, 1.05 * lowest), 1.03), xlabel="time, s", ylabel="share of the feasible maximum")
    axes.set_xlim(0, max(samples.t[-1], scenario.sample_period))
    _legend_below(axes, 2)


def _draw_nearest(axes: Axes, flights: Sequence[AnyFlight], samples: list[Samples], names: list[str]) -> None:
    """Draw the smallest distance between two drones, and the collision distance."""
    for number, (flown, name) in enumerate(zip(samples, names, strict=True)):
        axes.plot(flown.t, flown.nearest, color=FLIGHTS[number], linewidth=0.8, alpha=0.85, label=name)
    limit = flights[0].scenario.r_coll
    axes.axhspan(0, limit, color=_DANGER, alpha=0.09, linewidth=0)
    axes.axhline(limit, color=_DANGER, linestyle=(0, (5, 3)), linewidth=1.1, label=f"r_coll = {limit:g} m")
    axes.set(xlabel="time, s", ylabel="distance, m", ylim=(0, None))
    axes.set_xlim(0, max(flown.t[-1] for flown in samples) or 1)
    axes.set_title("Distance between the nearest two drones")
    _legend_below(axes, 3)


def _draw_speeds(axes: Axes, flights: Sequence[AnyFlight], samples: list[Samples], names: list[str]) -> None:
    """Draw the mean speed, and the range from the slowest to the fastest drone."""
    for number, (flown, name) in enumerate(zip(samples, names, strict=True)):
        speed = np.linalg.norm(flown.velocity, axis=-1)
        axes.fill_between(flown.t, speed.min(axis=1), speed.max(axis=1), color=FLIGHTS[number], alpha=0.16, linewidth=0)
        axes.plot(flown.t, speed.mean(axis=1), color=FLIGHTS[number], linewidth=1.3, label=f"{name}: mean")
    v_flock = flights[0].scenario.v_flock
    axes.axhline(v_flock, color=_LIMIT, linestyle=(0, (5, 3)), linewidth=1.1, label=f"v_flock = {v_flock:g} m/s")
    axes.set(xlabel="time, s", ylabel="speed, m/s", ylim=(0, None))
    axes.set_xlim(0, max(flown.t[-1] for flown in samples) or 1)
    axes.set_title("Speed of the drones")
    band = Patch(color=FLIGHTS[0] if len(flights) == 1 else _LIMIT, alpha=0.16, label="slowest to fastest drone")
    _legend_below(axes, 2 if len(flights) > 1 else 3, [*axes.get_legend_handles_labels()[0], band])


def _legend_below(axes: Axes, columns: int, handles: list[Any] | None = None) -> None:
    """Add a legend at a fixed distance below the x axis, independent of the axes' height."""
    below = axes.transAxes + ScaledTranslation(0, -0.44, axes.get_figure().dpi_scale_trans)  # type: ignore[union-attr]
    style: dict[str, Any] = {"ncols": columns, "borderaxespad": 0.0, "columnspacing": 1.4, "handlelength": 2.4}
    axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(0, 0), bbox_transform=below, **style)
