"""The compiled loop of a flight: the stages in the order in which they happen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import entry_kernel, kernel
from controllers.policies.interface import Sensed, SpeedLimits, desired_velocity
from moflock_mj.dynamics.interface import advance, take_fix, write_state
from moflock_mj.effects.fault_injection import fall, hold_blind, strike
from moflock_mj.metrics.order_parameters import Tally, Yardstick, count_sample, write_running
from moflock_mj.metrics.samples import Record
from moflock_mj.scenario.schedule import Clocks
from moflock_mj.sensing.gps import SensorModel, SensorState, remember
from moflock_mj.sensing.packet_faults import spoil_packets
from moflock_mj.sensing.sense import sense
from moflock_mj.simulation.random_numbers import Draws, noise_of_beat
from moflock_mj.world.state import World


class Stages(NamedTuple):
    """What a flight is made of; the types of `plant`, `params`, `arena` and `faults` choose the implementations."""

    clocks: Clocks
    plant: NamedTuple
    params: NamedTuple
    limits: SpeedLimits
    arena: NamedTuple
    sensors: SensorModel
    faults: NamedTuple
    yardstick: Yardstick


class Memory(NamedTuple):
    """All that changes in flight, but for what a plant keeps to itself.

    Attributes:
        world: the true state.
        desired: (2, N), m/s, world, the command in force.
        sensor_state: errors and packets in the air.
        sensed: what each drone knows.
        tally: sums behind the order parameters.
    """

    world: World
    desired: NDArray[np.float64]
    sensor_state: SensorState
    sensed: Sensed
    tally: Tally


@kernel
def _sample(stages: Stages, memory: Memory, record: Record, beat: int, k: int) -> None:
    """Judge the state at this beat and write sample k."""
    counts = beat >= stages.clocks.first_counted
    world, tally = memory.world, memory.tally
    record.nearest[k] = count_sample(world, stages.arena, stages.yardstick, counts, tally)
    write_running(tally, record.order_parameters[k])
    record.status[k] = tally.status
    record.desired[k] = memory.desired
    for i in range(tally.status.size):
        for axis in range(3):
            record.position[k, i, axis] = world.position[axis, i]
            record.velocity[k, i, axis] = world.velocity[axis, i]
    if record.qpos.shape[0] > 0:
        write_state(stages.plant, world, record.qpos[k], record.qvel[k])


@entry_kernel
def fly_beats(stages: Stages, memory: Memory, draws: Draws, record: Record, first: int, count: int) -> None:
    """Fly `count` beats from beat `first`; a flight's first call also samples the start.

    Args:
        stages: what the flight is made of.
        memory: the state; moves on.
        draws: random numbers for these beats.
        record: the samples that fall due; written.
        first: number of the first beat.
        count: number of beats.
    """
    clocks, world, faults = stages.clocks, memory.world, stages.faults
    sample, tick = 0, 0
    if first == 0:
        _sample(stages, memory, record, 0, 0)
        sample = 1
    for beat in range(first, first + count):
        strike(faults, world, beat)
        if beat % clocks.sense_every == clocks.remember_at:
            remember(memory.sensor_state, world, beat // clocks.sense_every)
            spoil_packets(faults, memory.sensor_state, world, beat // clocks.sense_every)
        if beat % clocks.sense_every == 0:
            heard = beat // clocks.sense_every - clocks.ticks_late
            sense(
                stages.sensors,
                memory.sensor_state,
                world,
                stages.arena,
                faults,
                heard,
                draws.gps[tick],
                draws.loss[tick],
                draws.fault_loss[tick],
                memory.sensed,
            )
            take_fix(stages.plant, memory.sensor_state.velocity_error[0], draws.fix[tick : tick + 1])
            desired_velocity(stages.params, stages.limits, memory.sensed, memory.desired)
            hold_blind(faults, memory.desired)
            tick += 1
        noise = noise_of_beat(draws, beat - first, clocks.steps_per_beat)
        advance(
            stages.plant, world, memory.desired, memory.sensor_state.velocity_error[0], noise, clocks.steps_per_beat
        )
        fall(faults, world)
        if (beat + 1) % clocks.sample_every == 0:
            _sample(stages, memory, record, beat + 1, sample)
            sample += 1
