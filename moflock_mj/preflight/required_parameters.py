"""Autopilot parameters that a flock requires: their allowed values, and the values that `--fix` sets.

Names and values are those of ArduCopter 4.7 (https://ardupilot.org/copter/docs/parameters.html) and PX4 1.17
(https://docs.px4.io/main/en/advanced_config/parameter_reference.html). ArduCopter 4.7 renamed many parameters of 4.6
and changed them to SI units (https://ardupilot.org/copter/docs/common-param-name-changes.html): both forms are listed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from controllers.airframe import GRAVITY
from moflock_mj.mavlink.dialect import GROUND_SYSTEM
from moflock_mj.preflight.results import CheckResult

_JERK = 20.0
"""Jerk limit, m/s^3. PX4's own modes begin with the measured acceleration, noise included, and reduce it at this rate.
Measured when stopping from 6 m/s in turns: with the default of 4, up to 16 m/s and 72 m until standstill; with 20,
8 m/s and 11 m."""
_DRIFT = 10.0
"""Extra radius of a fence around the home, m, since the home moves with the GPS error."""


_CONTINUES = "it continues after loss of the ground station"
_LATE = "it detects loss of the ground station too late"
_EMPTY = "it flies until its battery is empty"


class FlightRequirements(NamedTuple):
    """Requirements of the flight on one vehicle.

    Attributes:
        speed: maximum speed, m/s.
        acceleration: maximum acceleration, m/s^2.
        radius: distance from home to the farthest corner of the arena plus the fence margin, m.
        top: minimum altitude of the fence's top above home, m.
        return_altitude: return altitude above home, m, different for each vehicle.
    """

    speed: float
    acceleration: float
    radius: float
    top: float
    return_altitude: float


class RequiredParameter(NamedTuple):
    """Requirement on one parameter.

    Attributes:
        name: name of the parameter.
        holds: function that returns whether a value is allowed.
        value: value that `--fix` sets.
        limit: allowed values, in words.
        why: consequence of another value.
        otherwise: result for another value.
        missing: result if the vehicle does not have the parameter.
    """

    name: str
    holds: Callable[[float], bool]
    value: float
    limit: str
    why: str
    otherwise: CheckResult = CheckResult.FAILURE
    missing: CheckResult = CheckResult.WARNING


Spellings = tuple[RequiredParameter, ...]
"""One parameter in the names and units of several firmware versions; the first that the vehicle has is used."""


def required_parameters(autopilot: str, requirements: FlightRequirements) -> list[Spellings]:
    """Required parameters of "ardupilot" or "px4" in the order of setting, so that a fence is enabled last."""
    return {"ardupilot": _of_ardupilot, "px4": _of_px4}[autopilot](requirements)


def _of_ardupilot(requirements: FlightRequirements) -> list[Spellings]:
    tilt = math.ceil(math.degrees(math.atan(requirements.acceleration / GRAVITY)) + 5)
    slow, gentle = "it cannot fly as fast as the flock", "it turns more slowly than in the simulation"
    upright, other_station = (
        "it cannot accelerate as in the simulation",
        "its failsafe watches another ground station",
    )
    return [
        (
            _at_least("WP_SPD", requirements.speed, "m/s", slow),
            _at_least("WPNAV_SPEED", requirements.speed * 100, "cm/s", slow),
        ),
        (
            _at_least("WP_ACC", requirements.acceleration, "m/s^2", gentle),
            _at_least("WPNAV_ACCEL", requirements.acceleration * 100, "cm/s^2", gentle),
        ),
        (
            _at_least("ATC_ANGLE_MAX", tilt, "deg", upright),
            _at_least("ANGLE_MAX", tilt * 100, "cdeg", upright),
        ),
        (
            _one_of("MAV_GCS_SYSID", (GROUND_SYSTEM,), "the system id of this ground station", other_station),
            _one_of("SYSID_MYGCS", (GROUND_SYSTEM,), "the system id of this ground station", other_station),
        ),
        (
            _one_of(
                "FS_GCS_ENABLE",
                (5, 7, 1),
                "5 land, 7 brake or land, 1 return",
                _CONTINUES,
            ),
        ),
        (_between("FS_GCS_TIMEOUT", 2, 10, 5, "s", _LATE),),
        (_between("GUID_TIMEOUT", 0.5, 3, 3, "s", "it follows its last setpoint for too long"),),
        (
            _one_of(
                "BATT_FS_LOW_ACT",
                (1, 2, 3, 4),
                "1 land, 2 to 4 return",
                _EMPTY,
                CheckResult.WARNING,
            ),
        ),
        (_at_least("FENCE_ALT_MAX", requirements.top, "m", "its fence ends below its flight altitude"),),
        (_at_least("FENCE_RADIUS", requirements.radius, "m", "its fence ends within the arena", _DRIFT),),
        (_one_of("FENCE_ACTION", (1, 2, 3, 4, 5), "1 to 5, any action but a report", "it flies through its fence"),),
        (
            RequiredParameter(
                "FENCE_TYPE",
                lambda value: bool(int(value) & 1 and int(value) & 6),
                7,
                "a maximum altitude (1) and a circle (2) or polygon (4)",
                "its fence is not closed",
            ),
        ),
        (_one_of("FENCE_ENABLE", (1,), "1", "it has no fence", missing=CheckResult.FAILURE),),
        (
            _near("RTL_ALT_M", requirements.return_altitude, "m"),
            _near("RTL_ALT", requirements.return_altitude * 100, "cm"),
        ),
    ]


def _of_px4(requirements: FlightRequirements) -> list[Spellings]:
    tilt = math.degrees(math.atan(requirements.acceleration / GRAVITY))
    wanted = [
        _at_least("MPC_XY_VEL_MAX", requirements.speed, "m/s", "it cannot fly as fast as the flock"),
        # PX4 refuses an MPC_ACC_HOR above MPC_ACC_HOR_MAX.
        _at_least("MPC_ACC_HOR_MAX", requirements.acceleration, "m/s^2", "it turns more slowly than in the simulation"),
        _at_least("MPC_ACC_HOR", requirements.acceleration, "m/s^2", "it turns more slowly than in the simulation"),
        _at_least("MPC_JERK_AUTO", _JERK, "m/s^3", "it first accelerates and flies far before it holds"),
        _at_least("MPC_TILTMAX_AIR", math.ceil(tilt + 5), "deg", "it cannot accelerate as in the simulation"),
        _one_of("NAV_DLL_ACT", (3, 1, 2), "3 land, 1 hold, 2 return", _CONTINUES),
        _between("COM_DL_LOSS_T", 2, 15, 10, "s", _LATE),
        _one_of("COM_OBL_RC_ACT", (5, 4), "5 hold, 4 land", "it does not hold or land when setpoints stop"),
        _between("COM_OF_LOSS_T", 0.3, 2, 1, "s", "it follows its last setpoint for too long"),
        _one_of(
            "COM_LOW_BAT_ACT",
            (2, 3),
            "2 land, 3 return or land",
            _EMPTY,
            CheckResult.WARNING,
        ),
        _at_least(
            "GF_MAX_VER_DIST",
            requirements.top,
            "m",
            "its fence has no maximum altitude, or ends below its flight altitude",
        ),
        _at_least(
            "GF_MAX_HOR_DIST", requirements.radius, "m", "it has no fence, or its fence ends within the arena", _DRIFT
        ),
        _one_of(
            "GF_ACTION",
            (2, 3, 5),
            "2 hold, 3 return, 5 land",
            "it flies through its fence",
            missing=CheckResult.FAILURE,
        ),
        _near("RTL_RETURN_ALT", requirements.return_altitude, "m"),
    ]
    return [(want,) for want in wanted]


RETURN_ALTITUDE: Mapping[str, float] = {"RTL_ALT_M": 1.0, "RTL_ALT": 0.01, "RTL_RETURN_ALT": 1.0}
"""Parameters of the return altitude, and the unit of each in m."""


def _at_least(name: str, least: float, unit: str, why: str, spare: float = 0.0) -> RequiredParameter:
    value = float(math.ceil(least + spare))
    return RequiredParameter(name, lambda held: held >= least - 1e-6, value, f"at least {least:g} {unit}", why)


def _between(name: str, low: float, high: float, value: float, unit: str, why: str) -> RequiredParameter:
    return RequiredParameter(name, lambda held: low <= held <= high, value, f"{low:g} to {high:g} {unit}", why)


def _one_of(
    name: str,
    good: tuple[int, ...],
    limit: str,
    why: str,
    otherwise: CheckResult = CheckResult.FAILURE,
    missing: CheckResult = CheckResult.WARNING,
) -> RequiredParameter:
    return RequiredParameter(name, lambda value: value in good, good[0], limit, why, otherwise, missing)


def _near(name: str, value: float, unit: str) -> RequiredParameter:
    """A return altitude, which `--fix` sets but only the check of the whole flock evaluates."""
    return RequiredParameter(name, lambda _: True, value, f"{value:g} {unit} would stagger the flock", "")
