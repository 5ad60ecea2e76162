"""The random numbers of a flight, drawn beforehand for the compiled code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import kernel
from moflock_mj.dynamics.interface import Noise
from moflock_mj.effects.wind import GUST_DRAWS
from moflock_mj.scenario.scenario import Scenario


class RandomBatch(NamedTuple):
    """Random numbers for the beats of one call, drawn beforehand in the order in which they are used.

    Attributes:
        gps: (ticks, 2, 2, N), N(0, 1).
        loss: (ticks, N, N), uniform in [0, 1); (ticks, 0, 0) where no packet can be lost.
        fault_loss: (ticks, N, N), uniform in [0, 1); (ticks, 0, 0) where no fault loses packets.
        fix: (ticks, 2, N), N(0, 1), of barometer and compass.
        outer: (steps, 2, N), N(0, 1).
        gust: (beats, 5, N), N(0, 1).
        inertial: (steps, 6, N), uniform in [0, 1), of gyroscope and accelerometer.
        walk: (beats, 6, N), N(0, 1), of their biases.

    From `fix` on, the first axis is of length 0 where a flight takes none of a kind.
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
    """Draw what some beats need; the same in all, however a flight is cut into calls.

    Args:
        streams: the flight's generators.
        scenario: says which kinds a flight takes.
        dynamics: point masses take nothing of inertial sensors.
        ticks: in which the drones sense.
        intervals: see above.
        steps: integration steps in all of them.
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
    """What beat number `interval` of the drawn ones, of `steps` integration steps, takes."""
    step = interval * steps
    return Noise(
        draws.outer[step : step + steps],
        draws.gust[interval : interval + 1],
        draws.inertial[step : step + steps],
        draws.walk[interval : interval + 1],
    )


class RandomStreams(NamedTuple):
    """Independent generators; what one concern draws never shifts what another gets."""

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
        """The generators that belong to a seed, a whole number from 0."""
        children = np.random.SeedSequence(seed).spawn(len(cls._fields))
        return cls(*(np.random.Generator(np.random.SFC64(child)) for child in children))
