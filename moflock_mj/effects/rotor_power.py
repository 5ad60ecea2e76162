"""Electrical power of the rotors from their thrusts."""

from __future__ import annotations

from math import pi, sqrt

from controllers.airframe import Airframe
from controllers.compiling import hot_kernel
from moflock_mj.world.constants import AIR_DENSITY


def power_factor(airframe: Airframe) -> float:
    """Electrical power of a rotor divided by its thrust to the power of 1.5, W/N^1.5.

    In momentum theory, a rotor of area A with thrust T hovers at the ideal power T^1.5 / sqrt(2 rho A). The electrical
    power is the ideal power divided by a constant efficiency (J. G. Leishman: Principles of Helicopter Aerodynamics,
    2006, chapter 2).
    """
    area = pi * airframe.rotor_radius**2
    return 1 / (airframe.rotor_efficiency * sqrt(2 * AIR_DENSITY * area))


@hot_kernel
def rotor_power(factor: float, a: float, b: float, c: float, d: float) -> float:
    """Electrical power of four rotors with the thrusts a, b, c, d (N), W; `factor`: see `power_factor`."""
    return factor * (a * sqrt(a) + b * sqrt(b) + c * sqrt(c) + d * sqrt(d))
