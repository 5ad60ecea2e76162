"""What faults do to what drones tell, hear and read: the stages of sensing that a schedule of faults changes.

See `breakdown` for the faults and for what drones make of them.
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
    """Change what the packets of a moment tell, or send none.

    Args:
        faults: what is broken.
        state: its ring of the past holds the moment already.
        world: the true state.
        moment: its number.
    """


@stage
def corrupt_fixes(faults: NamedTuple, state: SensorState, t_gps: float) -> None:
    """Let the errors of drones without GPS go on without fixes.

    Args:
        faults: what is broken.
        state: its errors have drifted as with GPS.
        t_gps: s, time since the tick before.
    """


@stage
def drop_neighbours(
    faults: NamedTuple, world: TrueState, moment: int, loss_draws: NDArray[np.float64], observation: Observation
) -> None:
    """Strike out whom each drone does not hear, or should not heed.

    Args:
        faults: what is broken.
        world: the true state.
        moment: of which the packets that arrive tell.
        loss_draws: (N, N), uniform in [0, 1), [i, j] for i hearing j; (0, 0) where no fault loses packets.
        observation: whose neighbours would be heard without faults.
    """


@stage
def recall_packets(faults: NamedTuple, state: SensorState, moment: int, t_gps: float, observation: Observation) -> None:
    """Write what earlier packets said, carried on to now.

    Args:
        faults: say how many are kept.
        state: the ring of the past, and the present errors.
        moment: of which the packets that arrive now tell.
        t_gps: s, between two packets.
        observation: its columns from N on are written.
    """


@stage
def shift_readings(faults: NamedTuple, position: NDArray[np.float64]) -> None:
    """Add jumps to what drones read of their positions, (2, N), m."""


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
        memory.age[i] = too_old + 1  # also of those that have flown out of range
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
        elif count == 0 and missing >= 2:  # of one alone it could be the other's radio
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
                place = state.past_position[slot, axis, j] + age * t_gps * velocity
                observation.received_position[axis, j + age * drones] = place + state.position_error[1, axis, j]
                observation.received_velocity[axis, j + age * drones] = velocity + state.velocity_error[1, axis, j]


@implements(shift_readings, FaultSchedule)
def _shift_readings(faults: FaultSchedule, position: NDArray[np.float64]) -> None:
    for axis in range(2):
        for i in range(faults.cannot_receive.size):
            position[axis, i] += faults.jump[axis, i]
