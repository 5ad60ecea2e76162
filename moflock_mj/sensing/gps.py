"""GPS errors of each drone, and states in transit as packets."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import kernel
from moflock_mj.world.state import TrueState


class SensorModel(NamedTuple):
    """Figures of the scenario for sensing and communication.

    Attributes:
        t_gps: interval of GPS fixes, s.
        sigma_inner: strength of the GPS error, m^2/s^2.
        lambda_gps: damping of the GPS error, 1/s.
        r_comm: range of communication, m.
        packet_loss: loss coefficient, 1/m^2: a packet over a distance d is lost with probability packet_loss d^2.
    """

    t_gps: float
    sigma_inner: float
    lambda_gps: float
    r_comm: float
    packet_loss: float


class SensorState(NamedTuple):
    """State of sensing between fixes.

    Process 0 is the error of a drone's measurement of itself. Process 1 is the error of its packets to others.

    Attributes:
        position_error: (2, 2, N), position error by process, axis and drone, m.
        velocity_error: (2, 2, N), velocity error by process, axis and drone, m/s.
        past_position: (H, 2, N), ring buffer of the positions in packets, m.
        past_velocity: (H, 2, N), ring buffer of the velocities in packets, m/s.
    """

    position_error: NDArray[np.float64]
    velocity_error: NDArray[np.float64]
    past_position: NDArray[np.float64]
    past_velocity: NDArray[np.float64]

    @classmethod
    def at_start(cls, world: TrueState, ticks_late: int) -> SensorState:
        """Create a state without errors, with the initial state as the content of the first packets.

        Args:
            world: the initial state.
            ticks_late: delay of packets in stored states.
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
    """Store the true state as the content of the packets of a moment (number of a stored state)."""
    slot = moment % state.past_position.shape[0]
    state.past_position[slot] = world.position[:2]
    state.past_velocity[slot] = world.velocity[:2]


@kernel
def drift_gps(model: SensorModel, state: SensorState, noise: NDArray[np.float64]) -> None:
    """Advance the damped random walk of all GPS errors by one fix; noise: (2, 2, N), N(0, 1)."""
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
