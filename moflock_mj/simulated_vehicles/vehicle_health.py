"""Estimator, GPS receiver and battery of a simulated vehicle."""

from __future__ import annotations

import dataclasses

# Flags of EKF_STATUS_REPORT and ESTIMATOR_STATUS, which agree in these bits.
_LOST = 0xA7
"""Attitude, velocities and height, with constant position: what ArduCopter reports before it has a position."""
_READY = 0x33F
"""Attitude, velocities, relative and absolute position and their predictions: ArduCopter in good health."""
_STARTING = 0x400
"""EKF_UNINITIALIZED."""

DEAD_RECKONING = 5.0
"""Time for which an estimator keeps its position without GPS, s (PX4's EKF2_NOAID_TOUT is 5 s)."""


class Estimator:
    """Position estimator of a vehicle that was switched on at time 0.

    Args:
        boot: time from which the position is usable, s. The attitude, and with it the pre-arm check of ArduCopter, is
            ready after a quarter of it: it was measured healthy 18 s before the position.
    """

    def __init__(self, boot: float) -> None:
        self._boot = boot
        self._time = 0.0
        self._last_fix = 0.0
        self.gps_fix = False
        """Whether the receiver has a 3D fix."""

    def update(self, time: float, gps_lost: bool) -> None:
        self._time = time
        self.gps_fix = not gps_lost and time >= self._boot / 4
        if self.gps_fix:
            self._last_fix = time

    @property
    def attitude_ready(self) -> bool:
        return self._time >= self._boot / 4

    @property
    def position_ready(self) -> bool:
        return self._time >= self._boot and self._time - self._last_fix <= DEAD_RECKONING

    @property
    def flags(self) -> int:
        if not self.attitude_ready:
            return _STARTING
        return _READY if self.position_ready else _LOST

    @property
    def variance(self) -> float:
        """Test ratio of position and velocity, where 1 is the innovation's limit; it grows without GPS."""
        return 0.05 + 0.25 * (self._time - self._last_fix) if self.attitude_ready else 1.0


@dataclasses.dataclass(kw_only=True)
class Battery:
    """Lithium-polymer battery that counts charge; its voltage falls linearly.

    Attributes:
        cells: number of cells in series.
        capacity: capacity, mAh.
        used: consumed charge, mAh.
        current: present current, A.
    """

    cells: int
    capacity: float = 6000.0
    used: float = 0.0
    current: float = 0.0

    IDLE = 0.7
    """Current of the electronics, A."""
    FLYING = 18.0
    """Current in hover, A; 6000 mAh then last 20 minutes."""

    def drain(self, seconds: float, flying: bool) -> None:
        self.current = self.FLYING if flying else self.IDLE
        self.used = min(self.used + self.current * seconds / 3.6, self.capacity)

    def set_remaining(self, share: float) -> None:
        self.used = (1 - share) * self.capacity

    @property
    def remaining(self) -> float:
        """Remaining share of charge."""
        return 1 - self.used / self.capacity

    @property
    def voltage(self) -> float:
        """Voltage, V: 4.2 V for a full cell, 3.3 V for an empty one."""
        return self.cells * (3.3 + 0.9 * self.remaining)
