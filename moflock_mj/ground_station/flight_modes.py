"""Flight modes of ArduCopter and PX4, and the message rates that a ground station requests: one table of each."""

from __future__ import annotations

import enum

from moflock_mj.mavlink.dialect import mavlink


class ArduCopterMode(enum.IntEnum):
    """HEARTBEAT's custom_mode of ArduCopter (https://ardupilot.org/copter/docs/flight-modes.html)."""

    STABILIZE = 0
    ACRO = 1
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    CIRCLE = 7
    LAND = 9
    POSHOLD = 16
    BRAKE = 17
    THROW = 18
    GUIDED_NOGPS = 20
    SMART_RTL = 21


def px4_mode(main: int, sub: int = 0) -> int:
    """HEARTBEAT's custom_mode of PX4 for a main mode and a sub-mode."""
    return main << 16 | sub << 24


class Px4Mode(enum.IntEnum):
    """HEARTBEAT's custom_mode of PX4 (https://docs.px4.io/main/en/flight_modes_mc/)."""

    MANUAL = px4_mode(1)
    ALTITUDE = px4_mode(2)
    POSITION = px4_mode(3)
    ACRO = px4_mode(5)
    OFFBOARD = px4_mode(6)
    STABILIZED = px4_mode(7)
    TAKEOFF = px4_mode(4, 2)
    HOLD = px4_mode(4, 3)
    MISSION = px4_mode(4, 4)
    RETURN = px4_mode(4, 5)
    LAND = px4_mode(4, 6)


_MODES: dict[int, type[ArduCopterMode] | type[Px4Mode]] = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: ArduCopterMode,
    mavlink.MAV_AUTOPILOT_PX4: Px4Mode,
}


def mode_name(autopilot: int, mode: int) -> str:
    """Name of a custom_mode; its number if the mode or the MAV_AUTOPILOT is unknown."""
    try:
        return _MODES[autopilot](mode).name
    except (KeyError, ValueError):
        return str(mode)


INSPECTION_RATES = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
}
"""Minimum rates of messages during pre-flight checks, Hz; positions come at 2 / t_gps if that is faster."""

ESTIMATOR_MESSAGES = {
    "ardupilot": mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    "px4": mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
}
"""Message that reports the state of the estimator, by the autopilot's name."""

DEPLOYMENT_RATES = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 25.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 10.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 0.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 0.0,
}
"""Message rates during a deployment, Hz. With a position each 40 ms, the position behind a setpoint is at most 40 ms
plus the link's delay old. The last two messages are redundant, and PX4 sends them unasked.
"""
