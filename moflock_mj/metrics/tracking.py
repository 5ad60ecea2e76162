"""How well a flight was flown, as its samples tell it: of rigid bodies and point masses alike."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from moflock_mj.metrics.samples import SampleBuffer
from moflock_mj.scenario.scenario import Scenario


class MotionFigures(NamedTuple):
    """Figures of a whole flight, from its samples.

    Attributes:
        velocity_error_rms: m/s, root of the mean over drones and samples of the squared distance between the
            horizontal velocity and the one commanded at that time. The sample of the start, when nothing is commanded
            yet, is left out.
        altitude_error_rms: m, root of the mean over drones and samples of the squared altitude error.
        way: m, that all drones together have flown: their speed summed over the samples after the start.
        separation_min: m, smallest distance between two drones; infinite for one drone.
        outside_max: m, farthest that a drone was outside the arena; 0 if none was.
    """

    velocity_error_rms: float
    altitude_error_rms: float
    way: float
    separation_min: float
    outside_max: float


class MotionMeter:
    """Sums up the records of a flight, one after the other.

    Args:
        scenario: what is flown.
        started: whether the first record begins after the start, such as that of a resumed flight.
    """

    def __init__(self, scenario: Scenario, *, started: bool = False) -> None:
        self._scenario = scenario
        self._started = started
        self._drone_samples = 0
        self._velocity_error_sq = self._altitude_error_sq = self._speed = 0.0
        self._nearest, self._outside = np.inf, 0.0

    def add(self, record: SampleBuffer) -> None:
        """Sum up the samples of a record."""
        altitude = self._scenario.altitude
        self._nearest = min(self._nearest, float(record.nearest.min()))
        self._outside = max(self._outside, float(self._scenario.arena.distance_outside(record.position).max()))
        flown = slice(0 if self._started else 1, None)
        self._started = True
        velocity, desired = record.velocity[flown], record.desired[flown].swapaxes(1, 2)
        self._drone_samples += velocity.shape[0] * velocity.shape[1]
        self._velocity_error_sq += float(np.square(velocity[..., :2] - desired).sum())
        self._altitude_error_sq += float(np.square(record.position[flown][..., 2] - altitude).sum())
        self._speed += float(np.sqrt(np.square(velocity).sum(axis=-1)).sum())

    def figures(self) -> MotionFigures:
        """Of all records until now."""
        count = max(self._drone_samples, 1)
        return MotionFigures(
            velocity_error_rms=sqrt(self._velocity_error_sq / count),
            altitude_error_rms=sqrt(self._altitude_error_sq / count),
            way=self._speed * self._scenario.sample_period,
            separation_min=self._nearest,
            outside_max=self._outside,
        )
