"""Tracking errors and separation of a flight, from its samples, for rigid bodies and point masses."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from moflock_mj.metrics.samples import SampleBuffer
from moflock_mj.scenario.scenario import Scenario


class MotionFigures(NamedTuple):
    """Figures of a whole flight, from its samples.

    Attributes:
        velocity_error_rms: root mean square over drones and samples of the difference between horizontal velocity and
            command, m/s, without the initial sample, which has no command.
        altitude_error_rms: root mean square of the altitude error over drones and samples, m.
        way: distance moving by all drones together, m, as the sum of speed times sample period after the start.
        separation_min: smallest distance between two drones, m; infinite for one drone.
        outside_max: largest distance of a drone outside the arena, m; 0 if none was outside.
    """

    velocity_error_rms: float
    altitude_error_rms: float
    way: float
    separation_min: float
    outside_max: float


class MotionMeter:
    """Accumulator of the figures over the records of a flight.

    Args:
        scenario: the scenario.
        started: True if the first record begins after the start, as in a resumed flight.
    """

    def __init__(self, scenario: Scenario, *, started: bool = False) -> None:
        self._scenario = scenario
        self._started = started
        self._drone_samples = 0
        self._velocity_error_sq = self._altitude_error_sq = self._speed = 0.0
        self._nearest, self._outside = np.inf, 0.0

    def add(self, record: SampleBuffer) -> None:
        """Add the samples of a record."""
        altitude = self._scenario.altitude
        self._nearest = min(self._nearest, float(record.nearest.min()))
        self._outside = max(self._outside, float(self._scenario.arena.distance_outside(record.position).max()))
        moving = slice(0 if self._started else 1, None)
        self._started = True
        velocity, desired = record.velocity[moving], record.desired[moving].swapaxes(1, 2)
        self._drone_samples += velocity.shape[0] * velocity.shape[1]
        self._velocity_error_sq += float(np.square(velocity[..., :2] - desired).sum())
        self._altitude_error_sq += float(np.square(record.position[moving][..., 2] - altitude).sum())
        self._speed += float(np.sqrt(np.square(velocity).sum(axis=-1)).sum())

    def figures(self) -> MotionFigures:
        """Figures of all records so far."""
        count = max(self._drone_samples, 1)
        return MotionFigures(
            velocity_error_rms=sqrt(self._velocity_error_sq / count),
            altitude_error_rms=sqrt(self._altitude_error_sq / count),
            way=self._speed * self._scenario.sample_period,
            separation_min=self._nearest,
            outside_max=self._outside,
        )
