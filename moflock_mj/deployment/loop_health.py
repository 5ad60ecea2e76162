"""Whether the controller itself is well: its loop keeps its time."""

from __future__ import annotations

LATE = 0.15
"""s, by which a tick may be late."""
PATIENCE = 1.0
"""s of late ticks more than of others, or one tick that is as late as this, after which the controller is not well."""
RECOVERY = 3.0
"""s of ticks in time, after which it is again."""


class Health:
    """Judges the loop by how late its ticks are.

    Args:
        period: s, of the ticks.
    """

    def __init__(self, period: float) -> None:
        self.well = True
        self._period = period
        self._late = 0.0
        self._in_time = 0.0
        self._before: float | None = None
        self._told: list[tuple[str, str]] = []

    def take(self, now: float, late: float) -> bool:
        """Take note of a tick at `now` that is so late, s; returns whether the controller is well."""
        gap = self._period if self._before is None else now - self._before
        self._before = now
        if late > LATE:
            self._late, self._in_time = min(self._late + gap, 2 * PATIENCE), 0.0
        else:
            # After a late tick others follow at once, which are in time: they make good for their own time alone.
            self._late, self._in_time = max(self._late - gap, 0.0), self._in_time + gap
        if self.well and (self._late > PATIENCE or late > PATIENCE):
            self.well = False
            self._told.append(("error", f"the controller is {late:.2f} s late: no heartbeats until it is well"))
        elif not self.well and self._in_time > RECOVERY:
            self.well = True
            self._told.append(("info", "the controller keeps its time again"))
        return self.well

    def told(self) -> list[tuple[str, str]]:
        """What is new, with its level."""
        told, self._told = self._told, []
        return told
