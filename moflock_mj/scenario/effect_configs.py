"""Sections of a scenario for physical effects, each off by default.

Rigid bodies use all sections but `PointMassConfig`. Point masses use `PointMassConfig`, `WindConfig` and, in wind,
`DragConfig`. The effects are implemented in `moflock_mj.effects`, `moflock_mj.sensing` and `moflock_mj.dynamics`.
"""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar

from moflock_mj.errors import ScenarioError
from moflock_mj.fields import Section, quantity

KNOT = 1852 / 3600
"""One knot, m/s."""


TURBULENCE = {"none": 0.0, "light": 15 * KNOT, "moderate": 30 * KNOT, "severe": 45 * KNOT}
"""Wind at 6 m (20 ft) of each turbulence level, m/s (MIL-F-8785C, figure 7)."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class WindConfig(Section):
    """Constant wind with gusts (Dryden turbulence of MIL-F-8785C, low altitude), see `moflock_mj.effects.wind`."""

    table: ClassVar[str] = "wind"

    speed: float = quantity(0.0, "m/s", "mean wind speed", low=0, high=60)
    direction: float = quantity(
        0.0,
        "rad",
        "direction to which the air moves, from the x axis towards the y axis",
        low=-2 * math.pi,
        high=2 * math.pi,
    )
    turbulence: str = quantity("none", "1", "turbulence level of MIL-F-8785C", choices=tuple(TURBULENCE))
    w20: float | None = quantity(
        None, "m/s", "wind at 6 m (20 ft) that defines the gusts, instead of turbulence", low=0, high=60
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.w20 is not None and self.turbulence != "none":
            raise ScenarioError(
                f"wind.w20: {self.w20:g} m/s conflicts with turbulence = {self.turbulence}: it must be the only one"
            )

    @property
    def gust_wind(self) -> float:
        """Wind at 6 m (20 ft) that defines the gusts, m/s; 0 for a steady wind."""
        return TURBULENCE[self.turbulence] if self.w20 is None else self.w20


@dataclasses.dataclass(frozen=True, kw_only=True)
class DragConfig(Section):
    """Quadratic drag of a body and linear drag of its rotors, see `moflock_mj.effects.drag`."""

    table: ClassVar[str] = "drag"

    area: float | None = quantity(
        None, "m^2", "drag coefficient times area of the body; the airframe's own if absent", low=0, high=10
    )
    rotor: float | None = quantity(
        None, "1/s", "rotor drag in hover divided by mass and speed; the airframe's own if absent", low=0, high=10
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class DownwashConfig(Section):
    """Jet below each drone and its force on drones below, see `moflock_mj.effects.downwash`."""

    table: ClassVar[str] = "downwash"

    drag_coefficient: float = quantity(
        1.17,
        "1",
        "drag coefficient of a drone's rotor discs in the jet, that of a flat disc (Hoerner 1965)",
        low=0,
        high=10,
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class GroundEffectConfig(Section):
    """Additional thrust close to the ground (Cheeseman and Bennett 1955), see `moflock_mj.effects.ground_effect`."""

    table: ClassVar[str] = "ground_effect"

    height: float = quantity(0.0, "m", "height of the ground", low=-1e4, high=1e4)


@dataclasses.dataclass(frozen=True, kw_only=True)
class BatteryConfig(Section):
    """Lithium polymer battery (Chen and Rincon-Mora 2006), see `moflock_mj.effects.battery`."""

    table: ClassVar[str] = "battery"

    charge: float = quantity(1.0, "1", "initial charge as a fraction of the capacity", low=0, open_low=True, high=1)
    capacity: float | None = quantity(
        None, "C", "charge of a full battery (3600 C are 1 Ah); the airframe's own if absent", low=1, high=1e7
    )
    resistance: float | None = quantity(
        None, "ohm", "internal resistance of the whole battery; the airframe's own if absent", low=0, high=10
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class ImuConfig(Section):
    """Noise of the sensors for the estimates of attitude, velocity and height, see `moflock_mj.sensing.imu`.

    Gyroscope and accelerometer: Bosch BMI088 datasheet, 0.014 deg/s and 190 ug per sqrt(Hz) (the noisier z axis).
    Random walks of the biases, absent from datasheets: ADIS16448, measured for the EuRoC data (Burri et al. 2016).
    Barometer: TE MS5611 datasheet, 10 cm. Compass: Honeywell HMC5883L datasheet, 1 to 2 degrees.
    """

    table: ClassVar[str] = "imu"

    gyro_noise: float = quantity(2.44e-4, "rad/s/sqrt(Hz)", "noise density of the gyroscope", low=0, high=0.1)
    gyro_walk: float = quantity(1.94e-5, "rad/s^2/sqrt(Hz)", "random walk of the gyroscope bias", low=0, high=0.1)
    accel_noise: float = quantity(1.86e-3, "m/s^2/sqrt(Hz)", "noise density of the accelerometer", low=0, high=1)
    accel_walk: float = quantity(3.0e-3, "m/s^3/sqrt(Hz)", "random walk of the accelerometer bias", low=0, high=1)
    baro_noise: float = quantity(0.1, "m", "standard deviation of the barometer's height", low=0, high=10)
    compass_noise: float = quantity(0.035, "rad", "standard deviation of the compass's heading", low=0, high=1)


@dataclasses.dataclass(frozen=True, kw_only=True)
class PointMassConfig(Section):
    """Response of point masses, as identified by `moflock identify` for an airframe with its controllers.

    Rigid bodies keep the scenario's tau and a_max, from which their controllers are designed.
    """

    table: ClassVar[str] = "point_mass"

    tau: float = quantity(1.0, "s", "time constant of the velocity response", low=0.05, high=60)
    a_max: float = quantity(6.0, "m/s^2", "largest acceleration", low=0, open_low=True, high=100)
    delay: float = quantity(0.0, "s", "delay from the velocity error to the acceleration", low=0, high=10)
