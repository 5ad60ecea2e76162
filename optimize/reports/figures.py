"""Figures of a search; each function draws and returns one."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from moflock_mj.files import new_file
from moflock_mj.parameters.bounds import ParameterBounds
from moflock_mj.visualization.figure_style import BLACK, BLUE, GREEN, GREY, ORANGE, PINK, RED, STYLE
from optimize.analysis.pca import PrincipalComponents
from optimize.analysis.published_results import PAPER_RESULTS
from optimize.search.front import ReevaluatedFront

DOTS_PER_INCH = 130


class Landmark(NamedTuple):
    """Point with which a front is compared.

    Attributes:
        label: label in the legend.
        mean: (2,), mean objectives.
        deviation: (2,), standard deviations over the flights.
        colour: colour of the marker.
        marker: matplotlib's code of the marker.
    """

    label: str
    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]
    colour: str
    marker: str


def png(figure: Figure) -> bytes:
    """Encode a figure as PNG."""
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=DOTS_PER_INCH, format="png")
    return drawn.getvalue()


def data_url(image: bytes) -> str:
    """Data URL of a PNG."""
    return "data:image/png;base64," + base64.b64encode(image).decode("ascii")


def save(draw: Callable[[], Figure], out: str | os.PathLike[str]) -> None:
    """Draw a figure in the style of the project and write it as PNG.

    Raises:
        RenderError: the file cannot be written.
    """
    with new_file(out) as place:
        place.write_bytes(drawn_png(draw))


def drawn_png(draw: Callable[[], Figure]) -> bytes:
    """Draw a figure in the style of the project and encode it as PNG."""
    with rc_context(STYLE):
        return png(draw())


def new_figure(width: float, height: float) -> Figure:
    """Empty figure for files only; width and height in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def front_figure(front: ReevaluatedFront, landmarks: Sequence[Landmark]) -> Figure:
    """Front on fresh seeds with landmarks, as a whole and close to the knee; bars are one standard deviation."""
    figure = new_figure(11.5, 5.6)
    whole, close = figure.subplots(1, 2)
    for axes in (whole, close):
        _draw_front(axes, front)
        _draw_landmarks(axes, landmarks)
        axes.set(xlabel=front.objectives.names[0], ylabel=front.objectives.names[1])
    whole.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.05))
    whole.set_title(f"Mean ± standard deviation; hypervolume {front.hypervolume:.3f}")
    # The right panel shows the points with at least half of each of the knee's objectives.
    near = front.mean[front.remaining, :2]
    near = near[(near >= 0.5 * near[front.remaining == front.knee]).all(axis=1)]
    low, high = near.min(axis=0) - 0.04, near.max(axis=0) + 0.04
    close.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    close.set_title("Around the knee")
    close.annotate(
        "knee",
        tuple(front.mean[front.knee, :2]),
        (12, 12),
        textcoords="offset points",
        color=BLUE,
        fontweight="bold",
        arrowprops={"arrowstyle": "-", "color": BLUE},
    )
    figure.legend(*whole.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _draw_front(axes: Axes, front: ReevaluatedFront) -> None:
    """Draw the points on the front with bars, and the points that are dominated in the mean."""
    kept = front.remaining
    dominated = np.setdiff1d(np.arange(len(front.mean)), kept)
    if dominated.size:
        axes.plot(*front.mean[dominated].T[:2], ".", color=GREY, ms=4, alpha=0.6, label="dominated in the mean")
    across, up = front.mean[kept].T[:2]
    bars: dict[str, Any] = {"fmt": "none", "elinewidth": 0.6, "alpha": 0.35}
    axes.errorbar(across, up, *front.deviation[kept].T[1::-1], ecolor=BLUE, **bars)
    axes.plot(across, up, "o-", color=BLUE, ms=4, lw=1.2, label=f"front, mean over {len(front.seeds)} fresh seeds")


def _draw_landmarks(axes: Axes, landmarks: Sequence[Landmark]) -> None:
    for mark in landmarks:
        shape: dict[str, Any] = {"fmt": mark.marker, "color": mark.colour, "ms": 8, "mec": "white", "mew": 0.8}
        x, y = mark.mean
        error_x, error_y = mark.deviation
        axes.errorbar(x, y, error_y, error_x, elinewidth=1.1, capsize=2.5, label=mark.label, zorder=5, **shape)


def paper_landmarks() -> list[Landmark]:
    """Landmarks with the results that the paper prints for its points A and B."""
    return [
        Landmark(
            f"{name}, from the paper",
            np.array([reached.F_1[0], reached.F_2[0]]),
            np.array([reached.F_1[1], reached.F_2[1]]),
            GREY,
            marker,
        )
        for (name, reached), marker in zip(PAPER_RESULTS.items(), "<v", strict=True)
    ]


def generations_figure(fronts: Mapping[int, NDArray[np.float64]], names: Sequence[str]) -> Figure:
    """Fronts as estimated by the search after some generations: {generation: (n, 2)}."""
    figure = new_figure(7.2, 5.0)
    axes = figure.add_subplot()
    shades = colormaps["viridis"](np.linspace(0.9, 0.0, max(len(fronts), 1)))
    widths = np.linspace(5, 1, max(len(fronts), 1))  # so that an unchanged front is visible behind the next one
    for shade, width, (generation, values) in zip(shades, widths, sorted(fronts.items()), strict=True):
        ordered = values[np.argsort(values[:, 0])]
        axes.plot(ordered[:, 0], ordered[:, 1], "o-", color=shade, lw=width, ms=width + 1.5, label=f"{generation}")
    axes.set(xlabel=names[0], ylabel=names[1])
    axes.legend(title="after generation", loc="center left", bbox_to_anchor=(1.0, 0.5))
    axes.set_title("Estimated fronts after the last even generations")
    return figure


def hypervolume_figure(estimated: Mapping[str, tuple[NDArray[np.int64], NDArray[np.float64]]], flown: float) -> Figure:
    """Estimated hypervolume over flights, {run: (flights, hypervolume)}, and that of the front on fresh seeds."""
    figure = new_figure(7.2, 4.2)
    axes = figure.add_subplot()
    for (name, (flights, volume)), colour in zip(estimated.items(), (BLUE, RED, GREEN, PINK, BLACK), strict=False):
        axes.plot(
            flights, volume, drawstyle="steps-post", color=colour, lw=1.5, label=f"{name}, estimated by the search"
        )
    axes.axhline(flown, color=ORANGE, ls=(0, (5, 3)), label=f"front on fresh seeds: {flown:.3f}")
    axes.set(xlabel="flights", ylabel="hypervolume from (0, 0)", xlim=(0, None))
    figure.legend(loc="outside lower center", ncols=3)
    axes.set_title("Hypervolume of the front")
    return figure


def components_figure(
    found: PrincipalComponents, labels: Sequence[str], title: str, reference: NDArray[np.float64] | None = None
) -> Figure:
    """Covariance, first component, and explained variance of each component.

    Args:
        found: components of M variables.
        labels: (M,), labels of the variables.
        title: title of the covariance matrix.
        reference: (M,), another first component for comparison.
    """
    size = len(labels)
    figure = new_figure(11.5, 3.2 + 0.24 * size)
    axes = figure.subplots(1, 3, width_ratios=(1.55, 1, 0.85))
    image = axes[0].imshow(found.covariance, cmap="PuOr", vmin=-1, vmax=1)
    for (row, column), value in np.ndenumerate(found.covariance):
        ink = "white" if abs(value) > 0.6 else BLACK
        axes[0].text(column, row, f"{value:.2f}", ha="center", va="center", fontsize=8 if size < 8 else 5.5, color=ink)
    axes[0].set_xticks(range(size), labels, rotation=90 if size > 8 else 0)
    axes[0].set_yticks(range(size), labels)
    axes[0].grid(False)
    axes[0].set_title(title)
    figure.colorbar(image, ax=axes[0], shrink=0.8, label="covariance, standardised")
    places, height = np.arange(size), 0.4 if reference is not None else 0.7
    axes[1].barh(
        places - (height / 2 if reference is not None else 0), found.components[0], height, color=BLUE, label="here"
    )
    if reference is not None:
        axes[1].barh(places + height / 2, reference, height, color=ORANGE, label="paper")
        axes[1].legend(loc="best")
    axes[1].set_yticks(places, labels)
    axes[1].invert_yaxis()
    axes[1].axvline(0, color=BLACK, lw=0.8)
    axes[1].set(xlabel="weight in the first component")
    axes[1].set_title("First component")
    numbers = np.arange(1, len(found.explained) + 1)
    axes[2].bar(numbers, 100 * found.explained, color=BLUE)
    axes[2].plot(numbers, 100 * np.cumsum(found.explained), "o-", color=BLACK, ms=3, lw=1, label="cumulative")
    axes[2].set(xlabel="component", ylabel="explained variance, %", ylim=(0, 103), xticks=numbers[:: 1 + size // 10])
    axes[2].legend(loc="center right")
    axes[2].set_title("Explained variance")
    return figure


def parameters_figure(front: ReevaluatedFront, bounds: ParameterBounds) -> Figure:
    """Parameters of the points on the front over the mean first objective; the vertical axes span the bounds."""
    figure = new_figure(11.5, 6.6)
    grid = figure.subplots(-(-len(bounds.lower) // 4), 4, sharex=True, squeeze=False)
    numbers = front.remaining
    for index, (parameter, axes) in enumerate(zip(bounds.spec.parameters, grid.flat, strict=False)):
        axes.plot(front.mean[numbers, 0], front.points[numbers, index], "o", color=BLUE, ms=3.5)
        axes.plot(front.mean[front.knee, 0], front.points[front.knee, index], "D", color=RED, ms=6, label="knee")
        margin = 0.04 * (bounds.upper[index] - bounds.lower[index])
        axes.set_ylim(bounds.lower[index] - margin, bounds.upper[index] + margin)
        for bound in (bounds.lower[index], bounds.upper[index]):
            axes.axhline(bound, color=GREY, ls=(0, (5, 3)), lw=0.8)
        axes.set_title(parameter.label)
    for axes in grid[-1]:
        axes.set_xlabel(f"mean {front.objectives.names[0]}")
    grid[0, 0].legend(loc="best")
    return figure
