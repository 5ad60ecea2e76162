"""Section `[verdict]` of a scenario: acceptance limits of rigid-body flights."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from moflock_mj.fields import Section, quantity


@dataclasses.dataclass(frozen=True, kw_only=True)
class AcceptanceLimits(Section):
    """Acceptance limits of a point, applied to the worst of its rigid-body flights.

    A point is flyable if no drone touches, none is lost, and the first four limits hold. It is unsafe if any drone is
    lost, or drones touch in more than `touched_flights` of the flights. Otherwise it is marginal.
    """

    table: ClassVar[str] = "verdict"

    # Two x500 touch at 0.75 m, and a GPS position has an error of about a metre: two diameters leave a margin for one
    # gust and one late packet.
    separation: float = quantity(
        1.0, "m", "smallest distance of two drones; at least two airframe diameters", low=0, high=100
    )
    # A saturated rotor gives no control. Saturation in one step of a hundred is within the loops' margins of 6 dB.
    saturated: float = quantity(0.01, "1", "largest fraction of flight time with a rotor at its limit", low=0, high=1)
    # Drones must not pass above one another; the error of a barometer is about half a metre.
    altitude_error: float = quantity(1.0, "m", "largest error of altitude", low=0, high=1e4)
    # The paper's tolerance of F_wall, applied to the largest excursion instead of the mean, because a geofence acts on
    # any crossing.
    outside: float = quantity(5.0, "m", "largest distance of a drone outside the arena", low=0, high=1e4)
    # With the usual 20 seeds, touches in two flights may be chance; in three they are not rare.
    touched_flights: float = quantity(
        0.1, "1", "fraction of flights with touches above which a point is unsafe", low=0, high=1
    )

    def least_separation(self, diameter: float) -> float:
        """Smallest accepted distance of two drones of a given diameter, m."""
        return max(self.separation, 2 * diameter)
