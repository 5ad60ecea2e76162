"""Timing of setpoints: their jitter, and the delay from telemetry to setpoint."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class LatencyFigures(NamedTuple):
    """Setpoint timing of a whole flight.

    Attributes:
        setpoints: number of setpoints.
        jitter_p50: median deviation of the time between two setpoints to a vehicle from the period, ms.
        jitter_p99: 99th percentile of this deviation, ms.
        jitter_max: maximum of this deviation, ms.
        telemetry_p50: median delay from the arrival of a position to its setpoint, ms.
        telemetry_p99: 99th percentile of this delay, ms.
        telemetry_max: maximum of this delay, ms.
    """

    setpoints: int
    jitter_p50: float
    jitter_p99: float
    jitter_max: float
    telemetry_p50: float
    telemetry_p99: float
    telemetry_max: float

    def sentence(self) -> str:
        """The main figures, in words."""
        return (
            f"{self.setpoints} setpoints: jitter {self.jitter_p99:.1f} ms, telemetry to setpoint "
            f"{self.telemetry_p99:.1f} ms (99th percentiles; largest {self.jitter_max:.1f}, {self.telemetry_max:.1f})"
        )


class Latency:
    """Recorder of setpoint times.

    Args:
        period: nominal interval of setpoints to one vehicle, s.
        drones: number of vehicles.
    """

    def __init__(self, period: float, drones: int) -> None:
        self._period = period
        self._before: list[float | None] = [None] * drones
        self._jitter: list[float] = []
        self._telemetry: list[float] = []

    def note(self, drone: int, sent: float, arrived: float) -> None:
        """Record a setpoint: the time at which it was sent, and at which its position arrived, s."""
        before = self._before[drone]
        if before is not None:
            self._jitter.append(abs(sent - before - self._period))
        self._before[drone] = sent
        self._telemetry.append(sent - arrived)

    def figures(self) -> LatencyFigures | None:
        """Timing of all setpoints so far; None before the first two."""
        if not self._jitter:
            return None
        columns = [np.percentile(1e3 * np.array(values), (50, 99, 100)) for values in (self._jitter, self._telemetry)]
        return LatencyFigures(len(self._telemetry), *(round(float(value), 3) for value in np.concatenate(columns)))
