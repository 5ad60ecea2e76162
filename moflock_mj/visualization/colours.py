"""The colours of drones: by their speed or by the danger they are in, and the legend that says which is which."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from moflock_mj.errors import RenderError
from moflock_mj.log.schemas import STATUS_RGBA
from moflock_mj.metrics.order_parameters import CLOSE, OUTSIDE, TOUCHED
from moflock_mj.metrics.samples import Samples
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.visualization.figure_style import FLIGHTS

COLOURS = ("speed", "danger")
"""What a drone's colour can tell."""

# The upper seven tenths of viridis (S. van der Walt, N. Smith): on a dark ground its darkest part would hide.
_VIRIDIS = np.array(
    [
        [53, 95, 141],
        [42, 120, 142],
        [33, 145, 140],
        [34, 168, 132],
        [68, 191, 112],
        [122, 209, 81],
        [189, 223, 38],
        [253, 231, 37],
    ]
)
_FLIGHTS = np.array([list(bytes.fromhex(colour[1:])) for colour in FLIGHTS])
_WHITE = np.array([240, 240, 240])
_CALM, _OUTSIDE, _CLOSE, _TOUCHED = STATUS_RGBA[:, :3].astype(int)

_CALM_DISTANCE = 4.0
"""From how many r_coll on a neighbour is no danger."""

_TOP_SPEED = 1.25
"""Where the scale of speeds ends, in v_max: bodies overshoot a little."""


class LegendEntry(NamedTuple):
    """A line of the legend: a scale if it has bounds, else one colour.

    Attributes:
        label: what is coloured, with its unit.
        rgb: colours 0 to 255, evenly spaced along the scale.
        bounds: what the first and the last colour stand for, or nothing.
    """

    label: str
    rgb: Sequence[Sequence[int]]
    bounds: Sequence[float] = ()


Legend = tuple[LegendEntry, ...]


class Coloured(NamedTuple):
    """The colours of some flights.

    Attributes:
        rgb: for each flight (T, N, 3), u8.
        clearance: for each flight (T, N), m, from each drone to the nearest other one; infinite for a single drone.
        legend: what they mean.
    """

    rgb: list[NDArray[np.uint8]]
    clearance: list[NDArray[np.float64]]
    legend: Legend


def colour_drones(
    samples: Sequence[Samples], scenarios: Sequence[Scenario], names: Sequence[str], colour: str
) -> Coloured:
    """Colour the drones of one flight, or of two, each with shades of its own.

    Args:
        samples: of each flight.
        scenarios: of each flight.
        names: of each flight.
        colour: one of `COLOURS`.

    Raises:
        RenderError: the colour is unknown.
    """
    if colour not in COLOURS:
        raise RenderError(f"colour: {colour!r} is unknown; there are {', '.join(COLOURS)}")
    clearance = [clearances(flight.position) for flight in samples]
    compared = len(samples) > 1
    if colour == "speed":
        shades = [_speed_shades(number, compared) for number in range(len(samples))]
        top = round(_TOP_SPEED * max(scenario.v_max for scenario in scenarios), 1)
        rgb = [
            shade(table, np.linalg.norm(flight.velocity, axis=-1), 0.0, top)
            for table, flight in zip(shades, samples, strict=True)
        ]
        legend = [
            LegendEntry(f"{name}: speed, m/s" if compared else "speed, m/s", table.tolist(), (0.0, top))
            for name, table in zip(names, shades, strict=True)
        ]
        return Coloured(rgb, clearance, tuple(legend))
    shades = [_danger_shades(number, compared) for number in range(len(samples))]
    rgb = [
        danger_colours(table, away, flight.status, scenario.r_coll)
        for table, away, flight, scenario in zip(shades, clearance, samples, scenarios, strict=True)
    ]
    r_coll = scenarios[0].r_coll
    legend = [
        LegendEntry(f"{name}: nearest other, m" if compared else "nearest other drone, m", table.tolist(), bounds)
        for name, table, bounds in zip(names, shades, [(_CALM_DISTANCE * r_coll, r_coll)] * len(names), strict=True)
    ]
    flags = [("outside the arena", _OUTSIDE), (f"closer than {r_coll:g} m", _CLOSE), ("has touched", _TOUCHED)]
    legend += [LegendEntry(label, [tone.tolist()]) for label, tone in flags]
    return Coloured(rgb, clearance, tuple(legend))


def clearances(position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance from each drone to the nearest other one, (T, N), m; infinite for a single drone.

    Args:
        position: (T, N, 3), m.
    """
    if position.shape[1] == 1:
        return np.full(position.shape[:2], np.inf)
    return np.array([cKDTree(places).query(places, k=2)[0][:, 1] for places in position])


def danger_colours(
    table: NDArray[np.int64], clearance: NDArray[np.float64], status: NDArray[np.uint8], r_coll: float
) -> NDArray[np.uint8]:
    """Colours by danger, (T, N, 3); the worst that holds of a drone decides.

    Args:
        table: (K, 3), shades from no danger to r_coll.
        clearance: (T, N), m, to the nearest other drone.
        status: (T, N), flags OUTSIDE, CLOSE and TOUCHED.
        r_coll: m.
    """
    rgb = shade(table, -clearance, -_CALM_DISTANCE * r_coll, -r_coll)
    for flag, tone in ((OUTSIDE, _OUTSIDE), (CLOSE, _CLOSE), (TOUCHED, _TOUCHED)):
        rgb[(status & flag) > 0] = tone
    return rgb


def shade(table: NDArray[np.int64], value: NDArray[np.float64], low: float, high: float) -> NDArray[np.uint8]:
    """Colours of values, u8, with a last axis of 3.

    Args:
        table: (K, 3), shades evenly spaced from low to high.
        value: any shape.
        low: stands for the first shade, and so does all below it.
        high: stands for the last.
    """
    places = np.clip((value - low) / (high - low), 0, 1) * (len(table) - 1)
    channels = [np.interp(places, np.arange(len(table)), table[:, channel]) for channel in range(3)]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


def _speed_shades(number: int, compared: bool) -> NDArray[np.int64]:
    if not compared:
        return _VIRIDIS
    tone = _FLIGHTS[number]
    return np.array([0.4 * tone, tone, 0.45 * tone + 0.55 * _WHITE]).round().astype(np.int64)


def _danger_shades(number: int, compared: bool) -> NDArray[np.int64]:
    return np.array([_FLIGHTS[number] if compared else _CALM, _WHITE, _CLOSE])
