"""Downwash: jet below each drone, and its force on drones in the jet."""

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
    """Jets below the drones and their forces.

    Attributes:
        drag: drag of a drone's rotor discs, force divided by squared air speed, kg/m.
        thrust: thrust of all rotors of a drone in hover, N.
        fastest: largest speed of a jet, m/s.
        force: (N,), downward force on each drone, N.
    """

    drag: float
    thrust: float
    fastest: float
    force: NDArray[np.float64]


def make_downwash(scenario: Scenario, airframe: Airframe) -> Downwash | Off:
    """Create the downwash of a scenario."""
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
    """Update the force of each drone's jet on the drones below it; no effect without downwash.

    The jet of a hovering drone is a round turbulent jet with the momentum of its thrust T. The air speed on its axis at
    a distance z is U = B 2 sqrt(T / (pi rho)) / z, at most that of the slipstream in momentum theory. At a radius r it
    is U / (1 + a (r/z)^2)^2 with a = (sqrt(2) - 1) / S^2; B = 5.8, S = 0.094 (Hussein, Capp, George 1994, in
    S. B. Pope: Turbulent Flows, 2000, section 5.1). Measurements confirm such a jet from about 2.5 vehicle lengths
    below a quadrotor (Bauersfeld et al.: Robotics meets Fluid Dynamics, IEEE RA-L, 2025). The force on a drone in a jet
    is the drag of its rotor discs. The forces of several jets add. Jets point straight down, regardless of wind and
    tilt.

    Args:
        downwash: figures of the vehicle; its forces are written.
        qpos: (N, 7), the first three are the position, m, world.
    """


@hot_stage
def downwash_at(downwash: NamedTuple, i: int) -> float:
    """Downward force of the jets on drone i, N; zero without downwash."""
    return 0.0


JET_DECAY = 5.8
"""B of the jet, see `write_downwash`."""

JET_SPREAD = 0.094
"""S of the jet, see `write_downwash`."""

_JET_PROFILE = (sqrt(2.0) - 1) / JET_SPREAD**2

_JET_EDGE = 0.5
"""Largest r / z with a force. Beyond it the air speed is below 1 % of that on the axis."""


@implements(downwash_at, Downwash)
def _downwash_at(downwash: Downwash, i: int) -> float:
    return float(downwash.force[i])


@kernel
def jet_speed(downwash: Downwash, below: float, beside_sq: float) -> float:
    """Downward air speed in a jet, m/s.

    Args:
        downwash: figures of the vehicle.
        below: vertical distance below the drone, m, over 0.
        beside_sq: squared distance from the axis of the jet, m^2.
    """
    axis = min(JET_DECAY * 2 * sqrt(downwash.thrust / (pi * AIR_DENSITY)) / below, downwash.fastest)
    profile = 1 + _JET_PROFILE * beside_sq / (below * below)
    return axis / (profile * profile)


@implements(write_downwash, Downwash)
def _write_downwash(downwash: Downwash, qpos: NDArray[np.float64]) -> None:
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
