"""Faults in sensing and communication: the stages of sensing that a fault schedule changes.

`moflock_mj.effects.fault_injection` describes the faults and the reactions of the drones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import implements, stage
from controllers.policies.interface import Observation
from moflock_mj.effects.fault_injection import FALLEN, FaultSchedule
from moflock_mj.world.state import TrueState

if TYPE_CHECKING:
    from moflock_mj.sensing.gps import SensorState


@stage
def corrupt_packets(faults: NamedTuple, state: SensorState, world: TrueState, moment: int) -> None:
    """Change or suppress the packets of a moment; no effect without faults.

    Args:
        faults: the fault schedule.
        state: state of sensing, with the moment already stored.
        world: the true state.
        moment: number of the stored state.
    """


@stage
def corrupt_fixes(faults: NamedTuple, state: SensorState, t_gps: float) -> None:
    """Replace the GPS errors of drones without GPS by those of inertial sensors; no effect without faults.

    Args:
        faults: the fault schedule.
        state: state of sensing, with the errors of a GPS fix; changed.
        t_gps: interval of fixes, s.
    """


@stage
def drop_neighbours(
    faults: NamedTuple, world: TrueState, moment: int, loss_draws: NDArray[np.float64], observation: Observation
) -> None:
    """Remove neighbours whose packets were lost or must be ignored; no effect without faults.

    Args:
        faults: the fault schedule.
        world: the true state.
        moment: number of the stored state in the packets that arrive.
        loss_draws: (N, N), uniform in [0, 1), [i, j] for i receiving j; (0, 0) if no fault loses packets.
        observation: observation with the neighbours of a flight without faults; changed.
    """


@stage
def recall_packets(faults: NamedTuple, state: SensorState, moment: int, t_gps: float, observation: Observation) -> None:
    """Write the content of earlier packets, extrapolated to the present; no effect without faults.

    Args:
        faults: the fault schedule, with the number of packets to keep.
        state: state of sensing.
        moment: number of the stored state in the packets that arrive.
        t_gps: interval between two packets, s.
        observation: observation; its columns from N on are written.
    """


@stage
def shift_readings(faults: NamedTuple, position: NDArray[np.float64]) -> None:
    """Add gps_jump offsets to the measured own positions, (2, N), m; no effect without faults."""


@implements(corrupt_packets, FaultSchedule)
def _corrupt_packets(faults: FaultSchedule, state: SensorState, world: TrueState, moment: int) -> None:
    slot = moment % faults.memory.sent.shape[0]
    for i in range(faults.cannot_transmit.size):
        faults.memory.sent[slot, i] = not faults.cannot_transmit[i]
        faults.memory.height[slot, i] = world.position[2, i]
        for axis in range(2):
            state.past_position[slot, axis, i] += faults.jump[axis, i]


@implements(corrupt_fixes, FaultSchedule)
def _corrupt_fixes(faults: FaultSchedule, state: SensorState, t_gps: float) -> None:
    memory = faults.memory
    for process in range(2):
        for axis in range(2):
            g, h = state.position_error[process, axis], state.velocity_error[process, axis]
            last_g, last_h = memory.position_error[process, axis], memory.velocity_error[process, axis]
            for i in range(g.size):
                if faults.without_fix[i] >= 0:
                    h[i] = last_h[i]
                    g[i] = last_g[i] + t_gps * h[i]
                last_g[i], last_h[i] = g[i], h[i]


@implements(drop_neighbours, FaultSchedule)
def _drop_neighbours(
    faults: FaultSchedule, world: TrueState, moment: int, loss_draws: NDArray[np.float64], observation: Observation
) -> None:
    memory, lossy, ring = faults.memory, loss_draws.shape[0] > 0, faults.memory.sent.shape[0]
    drones, too_old = faults.cannot_receive.size, faults.kept + 1
    age_before = np.empty(drones, np.int64)
    for i in range(drones):
        age_before[:] = memory.age[i]
        memory.age[i] = too_old + 1  # including drones that are out of range now
        count, arrived, missing = 0, 0, 0
        for k in range(observation.neighbour_count[i]):
            j = observation.neighbours[i, k]
            lost = lossy and loss_draws[i, j] < max(faults.loss[i], faults.loss[j])
            arrives = not faults.cannot_receive[i] and memory.sent[moment % ring, j] and not lost
            age = 0 if arrives else age_before[j] + (age_before[j] < too_old)
            memory.age[i, j] = age
            arrived += arrives
            missing += age == too_old
            if age < too_old and memory.height[(moment - age) % ring, j] > world.position[2, i] - FALLEN:
                observation.neighbours[i, count] = j + age * drones
                count += 1
        observation.neighbour_count[i] = count
        if arrived > 0:
            memory.cut_off[i] = 0
        elif count == 0 and missing >= 2:  # with a single neighbour, the other's radio may have failed
            memory.cut_off[i] = 1


@implements(recall_packets, FaultSchedule)
def _recall_packets(
    faults: FaultSchedule, state: SensorState, moment: int, t_gps: float, observation: Observation
) -> None:
    drones = faults.cannot_receive.size
    for age in range(1, faults.kept + 1):
        slot = (moment - age) % state.past_position.shape[0]
        for axis in range(2):
            for j in range(drones):
                velocity = state.past_velocity[slot, axis, j]
                extrapolated = state.past_position[slot, axis, j] + age * t_gps * velocity
                observation.received_position[axis, j + age * drones] = extrapolated + state.position_error[1, axis, j]
                observation.received_velocity[axis, j + age * drones] = velocity + state.velocity_error[1, axis, j]


@implements(shift_readings, FaultSchedule)
def _shift_readings(faults: FaultSchedule, position: NDArray[np.float64]) -> None:
    for axis in range(2):
        for i in range(faults.cannot_receive.size):
            position[axis, i] += faults.jump[axis, i]
