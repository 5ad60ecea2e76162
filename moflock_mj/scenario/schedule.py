"""Schedule of a flight in whole numbers of integration steps."""

from __future__ import annotations

import math
from typing import NamedTuple

from moflock_mj.scenario.scenario import Scenario


class Schedule(NamedTuple):
    """Schedule of a flight: samples, sensing and packets happen at multiples of one interval.

    The interval is the greatest common divisor of sample period, sensing period and packet delay.

    Attributes:
        steps_per_interval: integration steps per interval.
        intervals: intervals of the whole flight.
        sample_every: intervals between two samples.
        sense_every: intervals between two GPS fixes, at which drones sense and decide.
        remember_at: remainder, modulo sense_every, of the intervals at which states are stored for packets.
        ticks_late: delay of a packet in stored states.
        first_counted: first interval whose sample enters the order parameters.
    """

    steps_per_interval: int
    intervals: int
    sample_every: int
    sense_every: int
    remember_at: int
    ticks_late: int
    first_counted: int

    @classmethod
    def of(cls, scenario: Scenario, step: float) -> Schedule:
        """Create the schedule of a scenario whose periods are whole multiples of `step`, s."""
        sample, sense, late, total, warm_up = (
            round(period / step)
            for period in (
                scenario.sample_period,
                scenario.t_gps,
                scenario.t_del,
                scenario.duration,
                scenario.warm_up,
            )
        )
        interval = math.gcd(sample, sense, late)
        return cls(
            steps_per_interval=interval,
            intervals=total // interval,
            sample_every=sample // interval,
            sense_every=sense // interval,
            remember_at=(-late % sense) // interval,
            ticks_late=-(-late // sense),
            first_counted=-(-warm_up // interval),
        )
