"""Downwash: the jet below each drone, and its force on the drones that it reaches."""

from __future__ import annotations

from math import pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.airframe import ROTORS, Airframe
from controllers.compiling import Off, hot_stage, implements, kernel, stage
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.world.constants import AIR_DENSITY


class Downwash(NamedTuple):
    """The jet of air below each drone.

    Attributes:
        drag: kg/m, of a drone's rotor discs: force over air speed squared.
        thrust: N, of all rotors of a drone in hover.
        fastest: m/s, of a jet that has not yet slowed down.
        force: (N,), N, downwards, on each drone.
    """

    drag: float
    thrust: float
    fastest: float
    force: NDArray[np.float64]


def make_downwash(scenario: Scenario, airframe: Airframe) -> Downwash | Off:
    """The downwash of a scenario."""
    if scenario.downwash is None:
        return Off()
    discs, thrust = ROTORS * pi * airframe.rotor_radius**2, ROTORS * airframe.hover_thrust()
    return Downwash(
        drag=AIR_DENSITY * scenario.downwash.drag_coefficient * discs / 2,
        thrust=thrust,
        fastest=2 * sqrt(thrust / (2 * AIR_DENSITY * discs)),
        force=np.zeros(scenario.drones),
    )


@stage
def write_downwash(downwash: NamedTuple, qpos: NDArray[np.float64]) -> None:
    """Find the force of each drone's jet on those below it.

    The jet of a hovering drone is a round turbulent one that carries the momentum of its thrust T: on its axis the air
    moves down at U = B 2 sqrt(T / (pi rho)) / z at a distance z, no faster than the slipstream of momentum theory, and
    beside it at U / (1 + a (r/z)^2)^2 with a = (sqrt(2) - 1) / S^2; B = 5.8, S = 0.094 (Hussein, Capp, George 1994,
    in S. B. Pope: Turbulent Flows, 2000, section 5.1). That quadrotors blow such jets from some 2.5 of their lengths
    down is measured by Bauersfeld et al. (Robotics meets Fluid Dynamics, IEEE RA-L, 2025). A drone in a jet is pushed
    down by the drag of its rotor discs. Jets add by their momentum. They blow straight down, whatever wind and tilt.

    Args:
        downwash: figures of the vehicle; the forces in it are written.
        qpos: (N, 7), the first three m, world.
    """


@hot_stage
def downwash_at(downwash: NamedTuple, i: int) -> float:
    """Force of the jets on drone i, N, downwards."""
    return 0.0


JET_DECAY = 5.8


JET_SPREAD = 0.094


_JET_PROFILE = (sqrt(2.0) - 1) / JET_SPREAD**2


_JET_EDGE = 0.5
"""Of r / z. Farther out the air moves at less than a hundredth of the axis's speed, and the force is left out."""


@implements(downwash_at, Downwash)
def _washed(downwash: Downwash, i: int) -> float:
    return float(downwash.force[i])


@kernel
def jet_speed(downwash: Downwash, below: float, beside_sq: float) -> float:
    """Speed of the air in a jet, m/s, downwards.

    Args:
        downwash: figures of the vehicle.
        below: m, how far under the drone; above 0.
        beside_sq: m^2, square of the distance from the jet's axis.
    """
    axis = min(JET_DECAY * 2 * sqrt(downwash.thrust / (pi * AIR_DENSITY)) / below, downwash.fastest)
    profile = 1 + _JET_PROFILE * beside_sq / (below * below)
    return axis / (profile * profile)


@implements(write_downwash, Downwash)
def _wash_those_below(downwash: Downwash, qpos: NDArray[np.float64]) -> None:
    drones = qpos.shape[0]
    downwash.force[:] = 0
    for i in range(drones):
        for j in range(i + 1, drones):
            x, y, z = qpos[j, 0] - qpos[i, 0], qpos[j, 1] - qpos[i, 1], qpos[j, 2] - qpos[i, 2]
            beside_sq, below = x * x + y * y, abs(z)
            if beside_sq >= _JET_EDGE * _JET_EDGE * below * below:
                continue
            speed = jet_speed(downwash, below, beside_sq)
            downwash.force[i if z > 0 else j] += downwash.drag * speed * speed
