"""GPS: the error of each drone's position, and its memory of what was sent."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import kernel
from moflock_mj.world.state import TrueState


class SensorModel(NamedTuple):
    """Figures of the scenario that sensing uses.

    Attributes:
        t_gps: s, period of sensing.
        sigma_inner: m^2/s^2, strength of the GPS error.
        lambda_gps: 1/s, damping of the GPS error.
        r_comm: m, range of communication.
        packet_loss: 1/m^2, a packet over a distance d is lost with probability packet_loss d^2.
    """

    t_gps: float
    sigma_inner: float
    lambda_gps: float
    r_comm: float
    packet_loss: float


class SensorState(NamedTuple):
    """What sensing carries from tick to tick. Process 0 is the error of what a drone reads of itself, process 1 that
    of what the others receive of it.

    Attributes:
        position_error: (2, 2, N), process, axis, drone; m.
        velocity_error: (2, 2, N), m/s.
        past_position: (H, 2, N), a ring of the positions that packets in the air tell of, m.
        past_velocity: (H, 2, N), m/s.
    """

    position_error: NDArray[np.float64]
    velocity_error: NDArray[np.float64]
    past_position: NDArray[np.float64]
    past_velocity: NDArray[np.float64]

    @classmethod
    def at_start(cls, world: TrueState, ticks_late: int) -> SensorState:
        """No error yet, and a past filled with the initial state, so that every first packet has a content.

        Args:
            world: the initial state.
            ticks_late: how far back the past goes, in remembered moments.
        """
        drones = world.position.shape[1]
        return cls(
            position_error=np.zeros((2, 2, drones)),
            velocity_error=np.zeros((2, 2, drones)),
            past_position=np.repeat(world.position[None, :2], ticks_late + 1, axis=0),
            past_velocity=np.repeat(world.velocity[None, :2], ticks_late + 1, axis=0),
        )


@kernel
def remember(state: SensorState, world: TrueState, moment: int) -> None:
    """Put the true state into the ring, as what packets of this moment tell."""
    slot = moment % state.past_position.shape[0]
    state.past_position[slot] = world.position[:2]
    state.past_velocity[slot] = world.velocity[:2]


@kernel
def drift_gps(model: SensorModel, state: SensorState, noise: NDArray[np.float64]) -> None:
    """One step of the damped random walk of all GPS errors; noise: (2, 2, N), N(0, 1)."""
    kick = sqrt(2 * model.lambda_gps * model.sigma_inner * model.t_gps)
    damping = model.lambda_gps * model.t_gps
    spring = sqrt(2 * model.lambda_gps * model.sigma_inner) / 3 * model.t_gps
    for process in range(2):
        for axis in range(2):
            g, h = state.position_error[process, axis], state.velocity_error[process, axis]
            xi = noise[process, axis]
            for i in range(g.size):
                h[i] += kick * xi[i] - damping * h[i] - spring * g[i]
                g[i] += model.t_gps * h[i]
