"""Sensing: GPS errors, late packets, limited range and packet loss turn the true world into what each drone knows."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import kernel
from controllers.policy import Sensed
from moflock_mj.arena import locate_walls
from moflock_mj.spoiled_sensing import drop_neighbours, recall_packets, shift_readings, spoil_fixes
from moflock_mj.world import World


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
    def at_start(cls, world: World, ticks_late: int) -> SensorState:
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
def remember(state: SensorState, world: World, moment: int) -> None:
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


@kernel
def _find_neighbours(model: SensorModel, world: World, loss_draws: NDArray[np.float64], sensed: Sensed) -> None:
    """List whom each drone hears: true distance now below r_comm, packet not lost; each pair is measured once.

    loss_draws: (N, N), uniform in [0, 1), [i, j] for i hearing j; (0, 0) where no packet can be lost.
    """
    x, y, z = world.position
    count = sensed.neighbour_count
    count[:] = 0
    lossy = loss_draws.shape[0] > 0
    reach_sq = model.r_comm * model.r_comm
    for i in range(x.size):
        for j in range(i + 1, x.size):
            distance_sq = (x[j] - x[i]) ** 2 + (y[j] - y[i]) ** 2 + (z[j] - z[i]) ** 2
            if distance_sq < reach_sq:
                if not (lossy and loss_draws[i, j] < model.packet_loss * distance_sq):
                    sensed.neighbours[i, count[i]] = j
                    count[i] += 1
                if not (lossy and loss_draws[j, i] < model.packet_loss * distance_sq):
                    sensed.neighbours[j, count[j]] = i
                    count[j] += 1


@kernel
def sense(
    model: SensorModel,
    state: SensorState,
    world: World,
    arena: NamedTuple,
    faults: NamedTuple,
    heard_moment: int,
    gps_noise: NDArray[np.float64],
    loss_draws: NDArray[np.float64],
    fault_draws: NDArray[np.float64],
    sensed: Sensed,
) -> None:
    """Refresh all that each drone knows.

    Args:
        model: figures of the scenario.
        state: errors and past; the errors move on by one tick.
        world: the true state now.
        arena: where the walls are.
        faults: see `moflock_mj.breakdown`, or Off.
        heard_moment: which moment of the past the packets that arrive now tell of.
        gps_noise: (2, 2, N), N(0, 1).
        loss_draws: (N, N), uniform in [0, 1); (0, 0) where no packet can be lost.
        fault_draws: (N, N), uniform in [0, 1); (0, 0) where no fault loses packets.
        sensed: written.
    """
    drift_gps(model, state, gps_noise)
    spoil_fixes(faults, state, model.t_gps)
    _find_neighbours(model, world, loss_draws, sensed)
    slot = heard_moment % state.past_position.shape[0]  # moments before the start find the initial state there
    drop_neighbours(faults, world, heard_moment, fault_draws, sensed)
    for axis in range(2):
        for i in range(world.position.shape[1]):
            sensed.own_position[axis, i] = world.position[axis, i] + state.position_error[0, axis, i]
            sensed.own_velocity[axis, i] = world.velocity[axis, i] + state.velocity_error[0, axis, i]
            sensed.heard_position[axis, i] = state.past_position[slot, axis, i] + state.position_error[1, axis, i]
            sensed.heard_velocity[axis, i] = state.past_velocity[slot, axis, i] + state.velocity_error[1, axis, i]
    recall_packets(faults, state, heard_moment, model.t_gps, sensed)
    shift_readings(faults, sensed.own_position)
    locate_walls(arena, sensed.own_position, sensed.wall_distance, sensed.wall_normal)
