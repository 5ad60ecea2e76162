"""Random numbers of a flight, drawn in batches for the compiled loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import kernel
from moflock_mj.dynamics.interface import Noise
from moflock_mj.effects.wind import GUST_DRAWS
from moflock_mj.scenario.scenario import Scenario


class RandomBatch(NamedTuple):
    """Random numbers for the intervals of one call, in the order of use.

    From `fix` on, the first axis has length 0 for a kind that the flight does not use.

    Attributes:
        gps: (fixes, 2, 2, N), N(0, 1), for GPS errors.
        loss: (fixes, N, N), uniform in [0, 1), for packet loss; (fixes, 0, 0) if no packet can be lost.
        fault_loss: (fixes, N, N), uniform in [0, 1), for link_loss; (fixes, 0, 0) if no fault loses packets.
        fix: (fixes, 2, N), N(0, 1), for barometer and compass.
        outer: (steps, 2, N), N(0, 1), for the velocity disturbance.
        gust: (intervals, 5, N), N(0, 1), for gusts.
        inertial: (steps, 6, N), uniform in [0, 1), for gyroscope and accelerometer.
        walk: (intervals, 6, N), N(0, 1), for their biases.
    """

    gps: NDArray[np.float64]
    loss: NDArray[np.float64]
    fault_loss: NDArray[np.float64]
    fix: NDArray[np.float64]
    outer: NDArray[np.float64]
    gust: NDArray[np.float64]
    inertial: NDArray[np.float32]
    walk: NDArray[np.float64]


def draw(
    streams: RandomStreams, scenario: Scenario, dynamics: str, *, ticks: int, intervals: int, steps: int
) -> RandomBatch:
    """Draw the random numbers of consecutive intervals, independent of the division of a flight into calls.

    Args:
        streams: generators of the flight.
        scenario: scenario, which determines the kinds of random numbers.
        dynamics: "rigid_body" or "point_mass"; point masses have no inertial sensors.
        ticks: number of GPS fixes.
        intervals: number of control intervals.
        steps: number of integration steps in all intervals.
    """
    drones = scenario.drones
    imu = dynamics == "rigid_body" and scenario.imu is not None
    lossy = drones if scenario.packet_loss_ratio > 0 else 0
    burst = drones if any(fault.kind == "link_loss" for fault in scenario.faults) else 0
    return RandomBatch(
        gps=streams.sensing.standard_normal((ticks, 2, 2, drones)),
        loss=streams.communication.random((ticks, lossy, lossy)),
        fault_loss=streams.faults.random((ticks, burst, burst)),
        fix=streams.fix.standard_normal((ticks if imu else 0, 2, drones)),
        outer=streams.disturbance.standard_normal((steps if scenario.wind is None else 0, 2, drones)),
        gust=streams.wind.standard_normal((intervals if scenario.wind else 0, GUST_DRAWS, drones)),
        inertial=streams.inertial.random((steps if imu else 0, 6, drones), np.float32),
        walk=streams.walk.standard_normal((intervals if imu else 0, 6, drones)),
    )


@kernel
def noise_of_interval(draws: RandomBatch, interval: int, steps: int) -> Noise:
    """Random numbers of one interval of `steps` integration steps; `interval` counts from the start of the batch."""
    step = interval * steps
    return Noise(
        draws.outer[step : step + steps],
        draws.gust[interval : interval + 1],
        draws.inertial[step : step + steps],
        draws.walk[interval : interval + 1],
    )


class RandomStreams(NamedTuple):
    """Independent random generators, one for each use, so that the uses do not affect each other."""

    start: np.random.Generator
    sensing: np.random.Generator
    communication: np.random.Generator
    disturbance: np.random.Generator
    wind: np.random.Generator
    inertial: np.random.Generator
    walk: np.random.Generator
    fix: np.random.Generator
    faults: np.random.Generator

    @classmethod
    def of(cls, seed: int) -> RandomStreams:
        """Create the generators of a seed, a whole number from 0."""
        children = np.random.SeedSequence(seed).spawn(len(cls._fields))
        return cls(*(np.random.Generator(np.random.SFC64(child)) for child in children))
