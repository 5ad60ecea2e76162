"""Colours of drones by speed or by danger (distance to the nearest drone), and their legend."""

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
"""Quantities that a drone's colour can show."""

# The upper 70 % of viridis (S. van der Walt, N. Smith), since its darkest part is not visible on a dark background.
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
"""Distance to a neighbour from which there is no danger, in r_coll."""

_TOP_SPEED = 1.25
"""End of the speed scale, in v_max, since rigid bodies overshoot slightly."""


class LegendEntry(NamedTuple):
    """A line of the legend: a scale if it has bounds, else one colour.

    Attributes:
        label: quantity with its unit.
        rgb: colours from 0 to 255, evenly spaced along the scale.
        bounds: values of the first and the last colour, or empty.
    """

    label: str
    rgb: Sequence[Sequence[int]]
    bounds: Sequence[float] = ()


Legend = tuple[LegendEntry, ...]


class Coloured(NamedTuple):
    """Colours of flights.

    Attributes:
        rgb: colours for each flight, (T, N, 3), u8.
        clearance: distance from each drone to the nearest other one for each flight, (T, N), m; infinite for a single
            drone.
        legend: legend of the colours.
    """

    rgb: list[NDArray[np.uint8]]
    clearance: list[NDArray[np.float64]]
    legend: Legend


def colour_drones(
    samples: Sequence[Samples], scenarios: Sequence[Scenario], names: Sequence[str], colour: str
) -> Coloured:
    """Colour the drones of one flight, or of two flights with separate shades.

    Args:
        samples: samples of each flight.
        scenarios: scenario of each flight.
        names: name of each flight.
        colour: one of `COLOURS`.

    Raises:
        RenderError: the colour is unknown.
    """
    if colour not in COLOURS:
        raise RenderError(f"colour: {colour!r} is unknown: it must be one of {', '.join(COLOURS)}")
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
        LegendEntry(f"{name}: nearest drone, m" if compared else "nearest other drone, m", table.tolist(), bounds)
        for name, table, bounds in zip(names, shades, [(_CALM_DISTANCE * r_coll, r_coll)] * len(names), strict=True)
    ]
    flags = [("outside the arena", _OUTSIDE), (f"closer than {r_coll:g} m", _CLOSE), ("had a contact", _TOUCHED)]
    legend += [LegendEntry(label, [tone.tolist()]) for label, tone in flags]
    return Coloured(rgb, clearance, tuple(legend))


def clearances(position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance from each drone to the nearest other one, (T, N), m; infinite for a single drone.

    Args:
        position: positions, (T, N, 3), m.
    """
    if position.shape[1] == 1:
        return np.full(position.shape[:2], np.inf)
    return np.array([cKDTree(places).query(places, k=2)[0][:, 1] for places in position])


def danger_colours(
    table: NDArray[np.int64], clearance: NDArray[np.float64], status: NDArray[np.uint8], r_coll: float
) -> NDArray[np.uint8]:
    """Colours by danger, (T, N, 3); the worst state of a drone determines its colour.

    Args:
        table: shades from no danger to r_coll, (K, 3).
        clearance: distance to the nearest other drone, (T, N), m.
        status: flags OUTSIDE, CLOSE and TOUCHED, (T, N).
        r_coll: collision distance, m.
    """
    rgb = shade(table, -clearance, -_CALM_DISTANCE * r_coll, -r_coll)
    for flag, tone in ((OUTSIDE, _OUTSIDE), (CLOSE, _CLOSE), (TOUCHED, _TOUCHED)):
        rgb[(status & flag) > 0] = tone
    return rgb


def shade(table: NDArray[np.int64], value: NDArray[np.float64], low: float, high: float) -> NDArray[np.uint8]:
    """Colours of values, u8, with a last axis of 3.

    Args:
        table: shades evenly spaced from low to high, (K, 3).
        value: values of any shape.
        low: value of the first shade; smaller values get the same shade.
        high: value of the last shade; larger values get the same shade.
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
