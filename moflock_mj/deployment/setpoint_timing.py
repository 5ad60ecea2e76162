"""How regular setpoints are, and how old the telemetry behind them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class LatencyFigures(NamedTuple):
    """Figures of a whole flight, ms.

    Attributes:
        setpoints: how many were sent.
        jitter_p50: of how far the time between two setpoints to a vehicle is from the period; so are the next two.
        jitter_p99: its 99th percentile.
        jitter_max: its largest.
        telemetry_p50: of the time from the arrival of a position to the setpoint that it led to; so are the next two.
        telemetry_p99: its 99th percentile.
        telemetry_max: its largest.
    """

    setpoints: int
    jitter_p50: float
    jitter_p99: float
    jitter_max: float
    telemetry_p50: float
    telemetry_p99: float
    telemetry_max: float

    def sentence(self) -> str:
        """The figures that matter, in words."""
        return (
            f"{self.setpoints} setpoints: jitter {self.jitter_p99:.1f} ms, telemetry to setpoint "
            f"{self.telemetry_p99:.1f} ms (99th percentiles; largest {self.jitter_max:.1f}, {self.telemetry_max:.1f})"
        )


class Latency:
    """Takes the times of setpoints.

    Args:
        period: s, between two to the same vehicle.
        drones: how many.
    """

    def __init__(self, period: float, drones: int) -> None:
        self._period = period
        self._before: list[float | None] = [None] * drones
        self._jitter: list[float] = []
        self._telemetry: list[float] = []

    def note(self, drone: int, sent: float, arrived: float) -> None:
        """A setpoint was sent, computed from a position that arrived then; s."""
        before = self._before[drone]
        if before is not None:
            self._jitter.append(abs(sent - before - self._period))
        self._before[drone] = sent
        self._telemetry.append(sent - arrived)

    def figures(self) -> LatencyFigures | None:
        """Of all setpoints so far; None before the first two."""
        if not self._jitter:
            return None
        columns = [np.percentile(1e3 * np.array(values), (50, 99, 100)) for values in (self._jitter, self._telemetry)]
        return LatencyFigures(len(self._telemetry), *(round(float(value), 3) for value in np.concatenate(columns)))
