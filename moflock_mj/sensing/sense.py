"""Sensing: observation of each drone from the true state, with GPS errors, packet delay, range and packet loss."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import kernel
from controllers.policies.interface import Observation
from moflock_mj.sensing.gps import SensorModel, SensorState, drift_gps
from moflock_mj.sensing.packet_faults import corrupt_fixes, drop_neighbours, recall_packets, shift_readings
from moflock_mj.world.state import TrueState
from moflock_mj.world.walls import locate_walls


@kernel
def _find_neighbours(
    model: SensorModel, world: TrueState, loss_draws: NDArray[np.float64], observation: Observation
) -> None:
    """List the drones from which each drone receives packets: true distance below r_comm, and packet not lost.

    loss_draws: (N, N), uniform in [0, 1), [i, j] for i receiving j; (0, 0) if no packet can be lost.
    """
    x, y, z = world.position
    count = observation.neighbour_count
    count[:] = 0
    lossy = loss_draws.shape[0] > 0
    reach_sq = model.r_comm * model.r_comm
    for i in range(x.size):
        for j in range(i + 1, x.size):
            distance_sq = (x[j] - x[i]) ** 2 + (y[j] - y[i]) ** 2 + (z[j] - z[i]) ** 2
            if distance_sq < reach_sq:
                if not (lossy and loss_draws[i, j] < model.packet_loss * distance_sq):
                    observation.neighbours[i, count[i]] = j
                    count[i] += 1
                if not (lossy and loss_draws[j, i] < model.packet_loss * distance_sq):
                    observation.neighbours[j, count[j]] = i
                    count[j] += 1


@kernel
def sense(
    model: SensorModel,
    state: SensorState,
    world: TrueState,
    arena: NamedTuple,
    faults: NamedTuple,
    received_moment: int,
    gps_noise: NDArray[np.float64],
    loss_draws: NDArray[np.float64],
    fault_draws: NDArray[np.float64],
    observation: Observation,
) -> None:
    """Update the observations of all drones at a fix.

    Args:
        model: figures of the scenario.
        state: state of sensing; the errors advance by one fix.
        world: the present true state.
        arena: the arena.
        faults: fault schedule, or Off, see `moflock_mj.effects.fault_injection`.
        received_moment: number of the stored state in the packets that arrive.
        gps_noise: (2, 2, N), N(0, 1).
        loss_draws: (N, N), uniform in [0, 1); (0, 0) if no packet can be lost.
        fault_draws: (N, N), uniform in [0, 1); (0, 0) if no fault loses packets.
        observation: observations; written.
    """
    drift_gps(model, state, gps_noise)
    corrupt_fixes(faults, state, model.t_gps)
    _find_neighbours(model, world, loss_draws, observation)
    slot = (
        received_moment % state.past_position.shape[0]
    )  # for moments before the start, the ring holds the initial state
    drop_neighbours(faults, world, received_moment, fault_draws, observation)
    for axis in range(2):
        for i in range(world.position.shape[1]):
            observation.own_position[axis, i] = world.position[axis, i] + state.position_error[0, axis, i]
            observation.own_velocity[axis, i] = world.velocity[axis, i] + state.velocity_error[0, axis, i]
            observation.received_position[axis, i] = (
                state.past_position[slot, axis, i] + state.position_error[1, axis, i]
            )
            observation.received_velocity[axis, i] = (
                state.past_velocity[slot, axis, i] + state.velocity_error[1, axis, i]
            )
    recall_packets(faults, state, received_moment, model.t_gps, observation)
    shift_readings(faults, observation.own_position)
    locate_walls(arena, observation.own_position, observation.wall_distance, observation.wall_normal)
