"""Health of the control loop: whether its ticks are on time."""

from __future__ import annotations

LATE = 0.15
"""Maximum delay of a tick, s."""
PATIENCE = 1.0
"""Accumulated time of late ticks minus ticks on time, or delay of one tick, s, from which the loop is unhealthy."""
RECOVERY = 3.0
"""Time without late ticks, s, after which the loop is healthy again."""


class Health:
    """Monitor of the delays of the control loop's ticks.

    Args:
        period: period of the ticks, s.

    Attributes:
        well: whether the loop is healthy.
    """

    def __init__(self, period: float) -> None:
        self.well = True
        self._period = period
        self._late = 0.0
        self._in_time = 0.0
        self._before: float | None = None
        self._events: list[tuple[str, str]] = []

    def take(self, now: float, late: float) -> bool:
        """Record a tick at `now` with its delay, s; returns whether the loop is healthy."""
        gap = self._period if self._before is None else now - self._before
        self._before = now
        if late > LATE:
            self._late, self._in_time = min(self._late + gap, 2 * PATIENCE), 0.0
        else:
            # After a late tick, ticks on time follow at once; each one only compensates for its own gap.
            self._late, self._in_time = max(self._late - gap, 0.0), self._in_time + gap
        if self.well and (self._late > PATIENCE or late > PATIENCE):
            self.well = False
            self._events.append(("error", f"the controller is {late:.2f} s late: heartbeats stop until it recovers"))
        elif not self.well and self._in_time > RECOVERY:
            self.well = True
            self._events.append(("info", "the controller is on time again"))
        return self.well

    def new_events(self) -> list[tuple[str, str]]:
        """Return the events since the last call, as level and text."""
        events, self._events = self._events, []
        return events
