"""Braking curve D of Vasarhelyi et al. 2018, and its inverse."""

from __future__ import annotations

from math import sqrt

from controllers.compiling import kernel


@kernel
def braking_curve(x: float, a: float, p: float) -> float:
    """Largest speed (m/s) from which a drone stops within x metres.

    The speed falls with slope p (1/s) near the end and with acceleration a (m/s^2) before: 0 for x p <= 0,
    x p for x p < a/p, sqrt(2 a x - (a/p)^2) beyond.
    """
    if x <= 0:
        return 0.0
    if x * p < a / p:
        return x * p
    return sqrt(2 * a * x - (a / p) ** 2)


@kernel
def braking_distance(v: float, a: float, p: float) -> float:
    """Distance (m) in which a drone stops from v m/s: the inverse of `braking_curve`."""
    if v < a / p:
        return v / p
    return (v * v / a + a / (p * p)) / 2
