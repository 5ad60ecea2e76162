"""Verdict on a point from its rigid-body flights and the acceptance limits of the scenario."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moflock_mj.scenario.acceptance import AcceptanceLimits

FLYABLE, MARGINAL, UNSAFE = "flyable", "marginal", "unsafe"


class Verdict(NamedTuple):
    """Verdict on a point.

    Attributes:
        name: "flyable", "marginal" or "unsafe".
        reason: decisive figure; for a flyable point the figure nearest to its limit.
    """

    name: str
    reason: str


class _Check(NamedTuple):
    """Figure in relation to its limit; `strain` is over 1 beyond the limit."""

    strain: float
    words: str


def judge(
    columns: Mapping[str, NDArray[np.float64]], failed: int, limits: AcceptanceLimits, diameter: float
) -> Verdict:
    """Check a point against the acceptance limits.

    Args:
        columns: (S,) each, figures of rigid-body flights by name, such as "lost"; NaN in failed flights.
        failed: number of failed flights.
        limits: acceptance limits of the scenario.
        diameter: diameter of the airframe, m.
    """
    lost, touched = columns["lost"] > 0, columns["touched"] > 0
    flights = len(lost)
    if failed:
        return Verdict(UNSAFE, f"{failed} of {flights} flights failed")
    if lost.any():
        return Verdict(UNSAFE, f"drones lost in {lost.sum()} of {flights} flights, {_largest_count(columns['lost'])}")
    if touched.mean() > limits.touched_flights:
        return Verdict(
            UNSAFE, f"drones touched in {touched.sum()} of {flights} flights, {_largest_count(columns['touched'])}"
        )
    if touched.any():
        return Verdict(
            MARGINAL, f"drones touched in {touched.sum()} of {flights} flights, {_largest_count(columns['touched'])}"
        )
    worst = max(_checks(columns, limits, diameter), key=lambda check: check.strain)
    return Verdict(MARGINAL if worst.strain > 1 else FLYABLE, worst.words)


def _largest_count(counts: NDArray[np.float64]) -> str:
    return f"at most {int(counts.max())} in one"


def _checks(columns: Mapping[str, NDArray[np.float64]], limits: AcceptanceLimits, diameter: float) -> list[_Check]:
    separation, least = float(columns["separation_min"].min()), limits.least_separation(diameter)
    checks = [
        _check(
            "rotors at their limit", 100 * columns["saturated_share"].max(), 100 * limits.saturated, "% of the time"
        ),
        _check("altitude error", columns["altitude_error_max"].max(), limits.altitude_error, "m"),
        _check("outside the arena", columns["outside_max"].max(), limits.outside, "m"),
    ]
    if np.isfinite(separation):  # it is infinite for a single drone
        words = f"smallest separation {separation:.2g} m, limit {least:.3g} m"
        checks.insert(0, _Check(least / separation if separation > 0 else np.inf, words))
    return checks


def _check(figure: str, value: float, limit: float, unit: str) -> _Check:
    strain = value / limit if limit > 0 else (np.inf if value > 0 else 0.0)
    return _Check(float(strain), f"{figure} {value:.2g} {unit}, limit {limit:.3g} {unit}")
