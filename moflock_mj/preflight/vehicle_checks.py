"""Checks of one vehicle's telemetry: link, arming checks, sensors, GPS, estimator, home, battery, state.

Thresholds are those of ArduPilot, PX4 and their ground stations.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.mavlink.dialect import Message, mavlink
from moflock_mj.mavlink.frames import Origin
from moflock_mj.preflight.results import CheckItem, CheckResult, check
from moflock_mj.scenario.scenario import Scenario

SILENT = 5.0
"""Maximum age of the last heartbeat of a live link, s."""
_STALE = 4.0
"""Maximum age of a current message, s."""
_SATELLITES = 6
_HDOP = 1.4
_H_ACC = {"ardupilot": 5.0, "px4": 3.0}
_VEL_ACC = {"ardupilot": 1.0, "px4": 0.5}
_VARIANCE = 0.8
_ACCURACY = 5.0
_AWAY = 10.0
"""Maximum distance of the vehicle from its home, m."""
_LOSS = 0.05
"""Maximum share of lost packets, unless the scenario has a larger one."""
_RESERVE = 0.2
"""Minimum share of charge at the end of the flight."""
_UNKNOWN_NEED = 0.5
"""Minimum share of charge at the start for a battery of unknown capacity."""

_PREARM = int(mavlink.MAV_SYS_STATUS_PREARM_CHECK)
_NOT_SENSORS = _PREARM | int(mavlink.MAV_SYS_STATUS_GEOFENCE) | int(mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER)
_GLITCH, _CONSTANT_POSITION = 0x400, 0x80
_POSITIONED = 0x1 | 0x2 | 0x10
"""Attitude, horizontal velocity, absolute horizontal position; the two messages agree in these flags."""
_BY_GPS = 0x200
"""Predicted absolute horizontal position: PX4 sets it while its estimator uses GPS."""


def about(vehicle: RemoteVehicle) -> str:
    return f"vehicle {vehicle.system}"


def readiness(vehicle: RemoteVehicle, autopilot: str, origin: Origin | None, scenario: Scenario) -> list[CheckItem]:
    """Check the telemetry of a vehicle; a value that is missing but can still arrive is RUNNING.

    Args:
        vehicle: the vehicle.
        autopilot: "ardupilot" or "px4".
        origin: origin of the world frame; None while a home is unknown.
        scenario: scenario of the deployment.
    """
    return [
        _link(vehicle),
        _standing(vehicle),
        _prearm(vehicle, autopilot),
        _sensors(vehicle),
        *_gps(vehicle, autopilot),
        *_estimator(vehicle, autopilot),
        *_home(vehicle, origin, scenario),
    ]


def link_items(vehicle: RemoteVehicle, scenario: Scenario, position_rate: float) -> list[CheckItem]:
    """Check the quality of a vehicle's link, measured over some seconds.

    Args:
        vehicle: the vehicle.
        scenario: scenario, with the delay, loss and rate for which the point was validated.
        position_rate: measured rate of GLOBAL_POSITION_INT, Hz.
    """
    trip, subject = vehicle.link.round_trip, about(vehicle)
    loss_max = max(scenario.packet_loss_ratio, _LOSS)
    return [
        check(
            "link's round trip", subject, good=trip <= scenario.t_del or (trip < 0.05), value=1e3 * trip, unit="ms",
            limit=f"at most t_del, {1e3 * scenario.t_del:g} ms",
            advice="use a better radio, or a point for longer delays",
        ),
        check(
            "link's loss", subject, good=vehicle.link.loss <= loss_max, value=100 * vehicle.link.loss, unit="%",
            limit=f"at most {100 * loss_max:g} %",
            advice="use a better radio, separate the antennas, or request fewer messages",
        ),
        check(
            "rate of positions", subject, good=position_rate >= 0.9 / scenario.t_gps, value=position_rate, unit="Hz",
            limit=f"at least {1 / scenario.t_gps:g} Hz, one per t_gps",
            advice="raise the link's data rate: SERIALn_BAUD, MAV_0_RATE",
        ),
    ]  # fmt: skip


def battery_item(
    vehicle: RemoteVehicle, capacity: float | None, energy: float | None, *, low: float = 0.0
) -> CheckItem:
    """Check that the charge suffices for the flight and a reserve.

    Args:
        vehicle: the vehicle.
        capacity: capacity of the full battery from the vehicle's parameters, mAh; None or 0 if unknown.
        energy: energy of one drone in the simulated flights, J; None if there were none.
        low: share of charge at which the vehicle's own failsafe acts.
    """
    status = vehicle.message("SYS_STATUS")
    volts = status.voltage_battery / 1e3 if status is not None and 0 < status.voltage_battery < 65535 else None
    known = capacity and volts and energy
    reserve = max(_RESERVE, low)
    need = energy / (capacity * 3.6 * volts) + reserve if known else max(_UNKNOWN_NEED, low)  # type: ignore[operator]
    basis = f"{100 * (need - reserve):.0f} % for the flight" if known else "half, of an unknown capacity"
    share = vehicle.battery
    if share is None:
        return CheckItem(
            name="battery", about=about(vehicle), result=CheckResult.WARNING, limit="reported",
            advice="its charge is not reported: set up BATT_MONITOR or BAT1_SOURCE",
        )  # fmt: skip
    return check(
        "battery", about(vehicle), good=share >= need, value=100 * share, unit="%",
        limit=f"at least {100 * need:.0f} %: {basis} and {100 * reserve:.0f} % left", advice="charge or change it",
    )  # fmt: skip


def _link(vehicle: RemoteVehicle) -> CheckItem:
    age = vehicle.age("HEARTBEAT")
    return check(
        "link alive", about(vehicle), good=age <= SILENT, value=age, unit="s", limit=f"a heartbeat within {SILENT:g} s",
        advice="check its radio and power",
    )  # fmt: skip


def _standing(vehicle: RemoteVehicle) -> CheckItem:
    landed = vehicle.landed
    state = f"{'armed' if vehicle.armed else 'disarmed'}, {_LANDED[landed]}, {vehicle.mode_name}"
    if landed is None and not vehicle.armed:
        return _running(
            "disarmed, on the ground", vehicle, state, "disarmed and on the ground", "its landed state is not reported"
        )
    return check(
        "disarmed, on the ground", about(vehicle), good=not vehicle.armed and landed is True, value=state,
        limit="disarmed and on the ground", advice="land and disarm it",
    )  # fmt: skip


_REASON = re.compile("arm|preflight", re.IGNORECASE)
"""Words of a status text with the reason why a vehicle does not arm: ArduPilot's PreArm:, PX4's Preflight Fail:."""
_LANDED = {True: "on the ground", False: "in the air", None: "landed state not reported"}


def _prearm(vehicle: RemoteVehicle, autopilot: str) -> CheckItem:
    """Check the pre-arm bit of SYS_STATUS.

    ArduCopter's bit was measured healthy 18 s before its position could be used, so the estimator is checked as well.
    PX4 sets the healthy bit only, never the present bit.
    """
    name, limit = "arming checks", "the autopilot would arm"
    status = _present(vehicle, "SYS_STATUS")
    if status is None:
        return _running(name, vehicle, None, limit, "SYS_STATUS does not arrive")
    if autopilot == "ardupilot" and not status.onboard_control_sensors_present & _PREARM:
        return CheckItem(
            name=name, about=about(vehicle), result=CheckResult.WARNING, value="not reported", limit=limit,
            advice="its firmware does not report them: see its own ground station",
        )  # fmt: skip
    if status.onboard_control_sensors_health & _PREARM:
        return check(name, about(vehicle), good=True, value=f"healthy in {vehicle.mode_name}", limit=limit, advice="")
    texts = [status_text.text for status_text in vehicle.texts if _REASON.search(status_text.text)]
    reasons = "; ".join(dict.fromkeys(texts[-6:]))
    value = reasons or "no reason reported"
    advice = f"resolve the reported problem: {reasons}" if reasons else "no reason reported: see its ground station"
    if autopilot == "px4":
        # PX4 does not report that it refuses to arm because of its mode.
        value = f"{value}, in {vehicle.mode_name}"
        advice = f"{advice}; it arms in HOLD, not in LAND, RETURN or OFFBOARD"
    return _running(name, vehicle, value, limit, advice)


def _sensors(vehicle: RemoteVehicle) -> CheckItem:
    status = _present(vehicle, "SYS_STATUS")
    if status is None:
        return _running("sensors", vehicle, None, "all healthy", "SYS_STATUS does not arrive")
    # PX4 reports a required sensor that it does not find as enabled but not present.
    on = status.onboard_control_sensors_enabled & ~_NOT_SENSORS
    unhealthy = on & ~status.onboard_control_sensors_health
    names = ", ".join(_sensor_names(unhealthy))
    if unhealthy:
        return _running("sensors", vehicle, names, "all healthy", f"not healthy: {names}; calibrate or replace")
    return check(
        "sensors", about(vehicle), good=True, value=f"{on.bit_count()} healthy", limit="all healthy", advice=""
    )


def _sensor_names(bits: int) -> list[str]:
    known = mavlink.enums["MAV_SYS_STATUS_SENSOR"]
    return [
        entry.name.removeprefix("MAV_SYS_STATUS_").removeprefix("SENSOR_").lower()
        for bit, entry in sorted(known.items())
        if bit & bits and not bit & (bit - 1)
    ]


def _gps(vehicle: RemoteVehicle, autopilot: str) -> list[CheckItem]:
    message = _present(vehicle, "GPS_RAW_INT")
    if message is None:
        return [_running("GPS", vehicle, None, "3D fix", "GPS_RAW_INT does not arrive")]
    wait = "place it under open sky, and wait"
    rows: list[tuple[str, float | None, str, str, Callable[[float], bool]]] = [
        ("GPS fix", float(message.fix_type), "", "3 (3D) or better", lambda fix: fix >= 3),
        (
            "GPS satellites", None if message.satellites_visible == 255 else float(message.satellites_visible), "",
            f"at least {_SATELLITES}", lambda count: count >= _SATELLITES,
        ),
        (
            "GPS HDOP", None if message.eph in (0, 65535) else message.eph / 100, "", f"at most {_HDOP:g}",
            lambda hdop: hdop <= _HDOP,
        ),
        (
            "GPS horizontal accuracy", message.h_acc / 1e3 if message.h_acc else None, "m",
            f"at most {_H_ACC[autopilot]:g} m",
            lambda accuracy: accuracy <= _H_ACC[autopilot],
        ),
        (
            "GPS speed accuracy", message.vel_acc / 1e3 if message.vel_acc else None, "m/s",
            f"at most {_VEL_ACC[autopilot]:g} m/s", lambda accuracy: accuracy <= _VEL_ACC[autopilot],
        ),
    ]  # fmt: skip
    return [
        check(name, about(vehicle), good=good(value), value=value, unit=unit, limit=limit, advice=wait,
               otherwise=CheckResult.RUNNING)
        for name, value, unit, limit, good in rows
        if value is not None
    ]  # fmt: skip


def _estimator(vehicle: RemoteVehicle, autopilot: str) -> list[CheckItem]:
    name = "EKF_STATUS_REPORT" if autopilot == "ardupilot" else "ESTIMATOR_STATUS"
    message = _present(vehicle, name)
    wait = "keep it still, away from iron and magnets, until its estimator has settled"
    if message is None:
        return [_running("estimator", vehicle, None, "with a position", f"{name} does not arrive")]
    flags = int(message.flags)
    good = flags & _POSITIONED == _POSITIONED
    # PX4 sets the constant-position flag whenever it stands still, with or without GPS.
    good = good and bool(flags & _BY_GPS if autopilot == "px4" else not flags & _CONSTANT_POSITION)
    # 0x400 is "not started" in EKF_STATUS_REPORT and "GPS glitch" in ESTIMATOR_STATUS: bad in both.
    good = good and not flags & _GLITCH
    items = [
        check(
            "estimator", about(vehicle), good=good, value=f"0x{flags:X}", limit="attitude, velocity, absolute position",
            advice=wait, otherwise=CheckResult.RUNNING,
        )
    ]  # fmt: skip
    fields = (
        ("velocity_variance", "pos_horiz_variance", "pos_vert_variance", "compass_variance")
        if autopilot == "ardupilot"
        else ("vel_ratio", "pos_horiz_ratio", "pos_vert_ratio", "mag_ratio")
    )
    worst = max(fields, key=lambda field: _finite(getattr(message, field)))
    value = _finite(getattr(message, worst))
    items.append(
        check(
            f"estimator's {worst.replace('_', ' ')}", about(vehicle), good=value < _VARIANCE, value=value,
            limit=f"under {_VARIANCE:g}", advice=wait, otherwise=CheckResult.RUNNING,
        )
    )  # fmt: skip
    if autopilot == "px4":
        accuracy = _finite(message.pos_horiz_accuracy)
        items.append(
            check(
                "estimator's accuracy", about(vehicle), good=accuracy <= _ACCURACY, value=accuracy, unit="m",
                limit=f"at most {_ACCURACY:g} m", advice=wait, otherwise=CheckResult.RUNNING,
            )
        )  # fmt: skip
    return items


def _home(vehicle: RemoteVehicle, origin: Origin | None, scenario: Scenario) -> list[CheckItem]:
    home, fix = vehicle.home(), vehicle.fix
    if home is None or fix is None or origin is None:
        return [_running("home", vehicle, None, "set", "its home is not set yet: wait for its GPS")]
    (home_x, home_y), (x, y) = origin.world(*home[:2]), origin.world(fix.latitude, fix.longitude)
    away, beyond = math.hypot(home_x - x, home_y - y), float(scenario.arena.distance_outside((home_x, home_y)))
    return [
        check(
            "home", about(vehicle), good=away <= _AWAY, value=away, unit="m",
            limit=f"within {_AWAY:g} m of its position", advice="power-cycle it at its take-off position",
        ),
        check(
            "home in the arena", about(vehicle), good=beyond <= 0, value=max(beyond, 0.0), unit="m",
            limit=f"0 m outside the {scenario.arena.title}",
            advice="move it, or the arena with --origin",
        ),
    ]  # fmt: skip


def _running(name: str, vehicle: RemoteVehicle, value: str | None, limit: str, advice: str) -> CheckItem:
    return CheckItem(
        name=name, about=about(vehicle), result=CheckResult.RUNNING, value=value, limit=limit, advice=advice
    )


def _present(vehicle: RemoteVehicle, name: str) -> Message | None:
    """The last message of a name, or None if it is stale."""
    return vehicle.message(name) if vehicle.age(name) <= _STALE else None


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 1e9
