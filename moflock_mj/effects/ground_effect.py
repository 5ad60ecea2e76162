"""Ground effect: additional rotor thrust close to the ground (Cheeseman and Bennett 1955)."""

from __future__ import annotations

from typing import NamedTuple

from controllers.airframe import Airframe
from controllers.compiling import Off, hot_stage, implements
from moflock_mj.scenario.scenario import Scenario


class GroundEffect(NamedTuple):
    """Ground below the rotors.

    Attributes:
        height: height of the ground, m, world.
        rotor_radius: radius of one rotor, m.
    """

    height: float
    rotor_radius: float


def make_ground_effect(scenario: Scenario, airframe: Airframe) -> GroundEffect | Off:
    """Create the ground effect of a scenario."""
    return (
        Off() if scenario.ground_effect is None else GroundEffect(scenario.ground_effect.height, airframe.rotor_radius)
    )


@hot_stage
def ground_lift(ground: NamedTuple, height: float) -> float:
    """Thrust of a rotor at `height` (m, world) relative to that far from the ground; 1 without ground effect.

    The ratio is 1 / (1 - (R / 4z)^2) for a rotor of radius R at z above the ground, constant below z = R/2, where the
    formula is no longer valid (I. C. Cheeseman, W. E. Bennett: The Effect of the Ground on a Helicopter Rotor in
    Forward Flight, ARC R&M 3021, 1955).
    """
    return 1.0


@implements(ground_lift, GroundEffect)
def _lift_over_ground(ground: GroundEffect, height: float) -> float:
    ratio = ground.rotor_radius / (4 * max(height - ground.height, ground.rotor_radius / 2))
    return 1 / (1 - ratio * ratio)
