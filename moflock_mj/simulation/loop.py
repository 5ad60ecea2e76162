"""Compiled loop of a flight, with its stages in the order of execution."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import entry_kernel, kernel
from controllers.policies.interface import Observation, SpeedLimits, desired_velocity
from moflock_mj.dynamics.interface import advance, take_fix, write_state
from moflock_mj.effects.fault_injection import apply_faults, ballistic_fall, hold_without_gps_or_link
from moflock_mj.metrics.order_parameters import MetricAccumulator, MetricRanges, count_sample, write_running
from moflock_mj.metrics.samples import SampleBuffer
from moflock_mj.scenario.schedule import Schedule
from moflock_mj.sensing.gps import SensorModel, SensorState, remember
from moflock_mj.sensing.packet_faults import corrupt_packets
from moflock_mj.sensing.sense import sense
from moflock_mj.simulation.random_numbers import RandomBatch, noise_of_interval
from moflock_mj.world.state import TrueState


class Components(NamedTuple):
    """Components of a flight. The types of `dynamics`, `params`, `arena` and `faults` select the implementations."""

    schedule: Schedule
    dynamics: NamedTuple
    params: NamedTuple
    limits: SpeedLimits
    arena: NamedTuple
    sensors: SensorModel
    faults: NamedTuple
    ranges: MetricRanges


class SimulationState(NamedTuple):
    """State of a running flight, except that of dynamics and faults.

    Attributes:
        world: the true state.
        desired: (2, N), present velocity command, m/s, world.
        sensor_state: GPS errors and packets in transit.
        observation: observations of all drones.
        accumulator: sums of the order parameters.
    """

    world: TrueState
    desired: NDArray[np.float64]
    sensor_state: SensorState
    observation: Observation
    accumulator: MetricAccumulator


@kernel
def _sample(components: Components, memory: SimulationState, record: SampleBuffer, interval: int, k: int) -> None:
    """Add the state at the start of an interval to the order parameters, and write sample k."""
    counts = interval >= components.schedule.first_counted
    world, accumulator = memory.world, memory.accumulator
    record.nearest[k] = count_sample(world, components.arena, components.ranges, counts, accumulator)
    write_running(accumulator, record.order_parameters[k])
    record.status[k] = accumulator.status
    record.desired[k] = memory.desired
    for i in range(accumulator.status.size):
        for axis in range(3):
            record.position[k, i, axis] = world.position[axis, i]
            record.velocity[k, i, axis] = world.velocity[axis, i]
    if record.qpos.shape[0] > 0:
        write_state(components.dynamics, world, record.qpos[k], record.qvel[k])


@entry_kernel
def run_intervals(
    components: Components, memory: SimulationState, draws: RandomBatch, record: SampleBuffer, first: int, count: int
) -> None:
    """Run `count` control intervals from number `first`; a flight's first call also writes the initial sample.

    Args:
        components: components of the flight.
        memory: state of the flight; advanced.
        draws: random numbers of these intervals.
        record: samples of these intervals; written.
        first: number of the first interval.
        count: number of intervals.
    """
    schedule, world, faults = components.schedule, memory.world, components.faults
    sample, fix_number = 0, 0
    if first == 0:
        _sample(components, memory, record, 0, 0)
        sample = 1
    for interval in range(first, first + count):
        apply_faults(faults, world, interval)
        if interval % schedule.sense_every == schedule.remember_at:
            remember(memory.sensor_state, world, interval // schedule.sense_every)
            corrupt_packets(faults, memory.sensor_state, world, interval // schedule.sense_every)
        if interval % schedule.sense_every == 0:
            received_moment = interval // schedule.sense_every - schedule.ticks_late
            sense(
                components.sensors,
                memory.sensor_state,
                world,
                components.arena,
                faults,
                received_moment,
                draws.gps[fix_number],
                draws.loss[fix_number],
                draws.fault_loss[fix_number],
                memory.observation,
            )
            take_fix(components.dynamics, memory.sensor_state.velocity_error[0], draws.fix[fix_number : fix_number + 1])
            desired_velocity(components.params, components.limits, memory.observation, memory.desired)
            hold_without_gps_or_link(faults, memory.desired)
            fix_number += 1
        noise = noise_of_interval(draws, interval - first, schedule.steps_per_interval)
        advance(
            components.dynamics,
            world,
            memory.desired,
            memory.sensor_state.velocity_error[0],
            noise,
            schedule.steps_per_interval,
        )
        ballistic_fall(faults, world)
        if (interval + 1) % schedule.sample_every == 0:
            _sample(components, memory, record, interval + 1, sample)
            sample += 1
