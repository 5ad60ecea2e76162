"""The section `[point_mass]` of a scenario: how point masses answer a velocity, where it differs from the asked way."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from moflock_mj.quantities import quantity
from moflock_mj.sections import Section


@dataclasses.dataclass(frozen=True, kw_only=True)
class PointMassResponse(Section):
    """The response of point masses alone, such as `moflock identify` finds it for an airframe with its controllers.

    Rigid bodies go on with the scenario's tau and a_max, from which their controllers are designed.
    """

    table: ClassVar[str] = "point_mass"

    tau: float = quantity(1.0, "s", "time constant of the velocity's response", low=0.05, high=60)
    a_max: float = quantity(6.0, "m/s^2", "bound of the acceleration", low=0, open_low=True, high=100)
    delay: float = quantity(
        0.0, "s", "after which the difference of commanded and measured velocity takes effect", low=0, high=10
    )
