"""The clocks of a flight, as whole numbers of integration steps."""

from __future__ import annotations

import math
from typing import NamedTuple

from moflock_mj.scenario.scenario import Scenario


class Schedule(NamedTuple):
    """A flight is a row of beats: the longest time after which something other than a step is due.

    Attributes:
        steps_per_interval: integration steps of a beat.
        intervals: beats of the whole flight.
        sample_every: beats between two samples.
        sense_every: beats between two times that the drones sense and decide.
        remember_at: a state is remembered for the packets at every beat that leaves this rest by sense_every.
        ticks_late: how many remembered moments a packet is late.
        first_counted: the first beat whose sample enters the order parameters.
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
        """The clocks of a scenario whose periods are whole multiples of `step`, s."""
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
