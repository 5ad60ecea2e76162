"""Samples of a flight: the buffer of the flight loop, and the arrays of a complete flight."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moflock_mj.metrics.catalogue import METRICS
from moflock_mj.metrics.fitness import Fitness, fitness_of
from moflock_mj.metrics.order_parameters import OrderParameters
from moflock_mj.scenario.scenario import Scenario


class Samples(NamedTuple):
    """T samples of the true states of N drones.

    Attributes:
        t: (T,), simulated time, s.
        position: (T, N, 3), position, m, world.
        velocity: (T, N, 3), velocity, m/s, world.
        desired_velocity: (T, N, 2), present velocity command, m/s, world.
        status: (T, N), flags OUTSIDE, CLOSE and TOUCHED of `order_parameters`.
        nearest: (T,), smallest distance between two drones, m.
        order_parameters: running order parameters, arrays over (T,).
    """

    t: NDArray[np.float64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    desired_velocity: NDArray[np.float64]
    status: NDArray[np.uint8]
    nearest: NDArray[np.float64]
    order_parameters: OrderParameters


def sample_times(scenario: Scenario, first: int, count: int) -> NDArray[np.int64]:
    """Simulated times of `count` samples from number `first` on, ns."""
    numbers = np.arange(first, first + count)
    return (numbers * round(scenario.sample_period * 1e9)).astype(np.int64)


def final_order_parameters(record: SampleBuffer) -> OrderParameters:
    """Order parameters up to the last sample of a record."""
    return OrderParameters(*record.order_parameters[-1].tolist())


def final_fitness(record: SampleBuffer, scenario: Scenario) -> Fitness:
    """Fitness up to the last sample of a record."""
    return fitness_of(final_order_parameters(record), scenario)


def join_samples(records: list[SampleBuffer], scenario: Scenario, first: int) -> Samples:
    """Join the samples of consecutive records, which start with sample number `first`."""
    joined = {
        name: np.concatenate([getattr(record, name) for record in records])
        for name in ("position", "velocity", "desired", "status", "nearest", "order_parameters")
    }
    return Samples(
        t=np.asarray(sample_times(scenario, first, len(joined["nearest"])) / 1e9, np.float64),
        position=joined["position"],
        velocity=joined["velocity"],
        desired_velocity=joined["desired"].swapaxes(1, 2),
        status=joined["status"],
        nearest=joined["nearest"],
        order_parameters=OrderParameters(*joined["order_parameters"].T),
    )


class SampleBuffer(NamedTuple):
    """Buffer for the K samples of one call of the flight loop, with complete states if a log needs them.

    Attributes:
        position: (K, N, 3), position, m, world.
        velocity: (K, N, 3), velocity, m/s, world.
        desired: (K, 2, N), present velocity command, m/s, world.
        status: (K, N), status flags.
        nearest: (K,), smallest distance between two drones, m.
        order_parameters: (K, 6), running order parameters.
        qpos: (K or 0, N, 7), position (m, world) and quaternion w x y z.
        qvel: (K or 0, N, 6), velocity (m/s, world) and body rates (rad/s, body).
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    desired: NDArray[np.float64]
    status: NDArray[np.uint8]
    nearest: NDArray[np.float64]
    order_parameters: NDArray[np.float64]
    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]

    @classmethod
    def empty(cls, samples: int, states: int, drones: int) -> SampleBuffer:
        """Buffer for `samples` samples and `states` complete states of `drones` drones."""
        return cls(
            position=np.empty((samples, drones, 3)),
            velocity=np.empty((samples, drones, 3)),
            desired=np.empty((samples, 2, drones)),
            status=np.empty((samples, drones), np.uint8),
            nearest=np.empty(samples),
            order_parameters=np.empty((samples, len(METRICS))),
            qpos=np.zeros((states, drones, 7)),
            qvel=np.zeros((states, drones, 6)),
        )
