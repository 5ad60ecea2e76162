"""The section `[verdict]` of a scenario: from which figures of its flights a point is called flyable or unsafe."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from moflock_mj.fields import Section, quantity


@dataclasses.dataclass(frozen=True, kw_only=True)
class AcceptanceLimits(Section):
    """Limits of rigid-body flights, each for the worst flight of a point.

    Flyable: no touch, no drone lost, and all of the first four limits kept. Unsafe: any drone lost, or touches in more
    than `touched_flights` of the flights. Marginal: between the two.
    """

    table: ClassVar[str] = "verdict"

    # The bodies of two x500 touch at 0.75 m, and GPS knows a drone's place to a metre or so: twice the diameter is what
    # is left of one gust and one late packet.
    separation: float = quantity(
        1.0, "m", "least distance of two drones; two airframe diameters, if that is more", low=0, high=100
    )
    # A rotor at its limit steers no more. In one step of a hundred, the loops' margins of 6 dB still cover it.
    saturated: float = quantity(0.01, "1", "largest share of the drones' time with a rotor at its limit", low=0, high=1)
    # Drones that pass above one another must not; barometers are good to half a metre.
    altitude_error: float = quantity(1.0, "m", "largest error of altitude", low=0, high=1e4)
    # The paper's tolerance of F_wall, as the farthest excursion rather than the mean one: fences are not crossed on
    # average.
    outside: float = quantity(5.0, "m", "farthest that a drone may leave the arena", low=0, high=1e4)
    # With the usual 20 seeds: two flights with a touch may be bad luck, three are not a rare event.
    touched_flights: float = quantity(
        0.1, "1", "share of flights with touches beyond which a point is unsafe", low=0, high=1
    )

    def least_separation(self, diameter: float) -> float:
        """The least distance, m, of two drones of a diameter, m."""
        return max(self.separation, 2 * diameter)
