"""A simulated PX4 multicopter: its modes, parameters, arming and failsafes.

Behaviour and defaults are those of PX4 1.17 (https://docs.px4.io/main/en/advanced_config/parameter_reference.html).
Measured peculiarities: a disarmed vehicle accepts OFFBOARD without a stream and then refuses to arm; a lost stream
makes the vehicle return; after a landing it is in OFFBOARD again.
"""

from __future__ import annotations

import math
from typing import ClassVar

from moflock_mj.ground_station.flight_modes import Px4Mode, px4_mode
from moflock_mj.mavlink.dialect import Message, mavlink
from moflock_mj.mavlink.frames import Origin
from moflock_mj.mavlink.parameters import INT32, REAL32, Parameter
from moflock_mj.simulated_vehicles.guidance import Body
from moflock_mj.simulated_vehicles.parameter_table import ParameterTable
from moflock_mj.simulated_vehicles.vehicle import Descent, Phase, ReturnPlan, SetpointRequest, Vehicle, VehicleTask

MANUAL, ALTITUDE, POSITION, OFFBOARD = Px4Mode.MANUAL, Px4Mode.ALTITUDE, Px4Mode.POSITION, Px4Mode.OFFBOARD
TAKEOFF, HOLD, MISSION = Px4Mode.TAKEOFF, Px4Mode.HOLD, Px4Mode.MISSION
RETURN, LAND = Px4Mode.RETURN, Px4Mode.LAND
_WITHOUT_POSITION = (MANUAL, ALTITUDE)
_WITH_STICKS = (MANUAL, ALTITUDE, POSITION)
_ENDS = (TAKEOFF, RETURN, LAND)
"""Modes that end at disarming, with a return to the mode before."""
_NO_TEXT = ""
"""Arming denial that PX4 reports by an event only, without a status text."""

_ACCEPTANCE = 10.0
"""NAV_ACC_RAD, m: distance from home within which a return needs no climb."""


def _defaults(system: int) -> dict[str, Parameter]:
    return {
        "MAV_SYS_ID": Parameter(INT32, system),
        "MAV_TYPE": Parameter(INT32, mavlink.MAV_TYPE_QUADROTOR),
        "SYS_AUTOSTART": Parameter(INT32, 4001),
        "COM_OF_LOSS_T": Parameter(REAL32, 1.0),
        "COM_OBL_RC_ACT": Parameter(INT32, 0),
        "COM_RC_IN_MODE": Parameter(INT32, 1),
        "COM_RCL_EXCEPT": Parameter(INT32, 0),
        "COM_DL_LOSS_T": Parameter(INT32, 10),
        "COM_LOW_BAT_ACT": Parameter(INT32, 0),
        "COM_ARM_BAT_MIN": Parameter(REAL32, 0.0),
        "COM_DISARM_PRFLT": Parameter(REAL32, 10.0),
        "COM_DISARM_LAND": Parameter(REAL32, 2.0),
        "COM_POS_FS_EPH": Parameter(REAL32, 5.0),
        "COM_VEL_FS_EVH": Parameter(REAL32, 1.0),
        "NAV_DLL_ACT": Parameter(INT32, 0),
        "NAV_RCL_ACT": Parameter(INT32, 2),
        "NAV_ACC_RAD": Parameter(REAL32, _ACCEPTANCE),
        "GF_ACTION": Parameter(INT32, 2),
        "GF_MAX_HOR_DIST": Parameter(REAL32, 0.0),
        "GF_MAX_VER_DIST": Parameter(REAL32, 0.0),
        "GF_SOURCE": Parameter(INT32, 0),
        "MIS_TAKEOFF_ALT": Parameter(REAL32, 2.5),
        "MPC_XY_VEL_MAX": Parameter(REAL32, 12.0),
        "MPC_XY_CRUISE": Parameter(REAL32, 5.0),
        "MPC_Z_VEL_MAX_UP": Parameter(REAL32, 3.0),
        "MPC_Z_VEL_MAX_DN": Parameter(REAL32, 1.5),
        "MPC_TKO_SPEED": Parameter(REAL32, 1.5),
        "MPC_LAND_SPEED": Parameter(REAL32, 0.7),
        "MPC_LAND_ALT1": Parameter(REAL32, 10.0),
        "MPC_LAND_ALT2": Parameter(REAL32, 5.0),
        "MPC_ACC_HOR": Parameter(REAL32, 3.0),
        "MPC_ACC_HOR_MAX": Parameter(REAL32, 5.0),
        "MPC_JERK_AUTO": Parameter(REAL32, 4.0),
        "MPC_TILTMAX_AIR": Parameter(REAL32, 45.0),
        "RTL_RETURN_ALT": Parameter(REAL32, 60.0),
        "RTL_DESCEND_ALT": Parameter(REAL32, 30.0),
        "RTL_LAND_DELAY": Parameter(REAL32, 0.0),
        "RTL_MIN_DIST": Parameter(REAL32, 10.0),
        "RTL_CONE_ANG": Parameter(INT32, 45),
        "RTL_TYPE": Parameter(INT32, 0),
        "BAT1_N_CELLS": Parameter(INT32, 4),
        "BAT1_CAPACITY": Parameter(REAL32, 6000.0),
        "BAT_LOW_THR": Parameter(REAL32, 0.15),
        "BAT_CRIT_THR": Parameter(REAL32, 0.07),
        "BAT_EMERGEN_THR": Parameter(REAL32, 0.05),
        "EKF2_REQ_NSATS": Parameter(INT32, 6),
        "EKF2_REQ_PDOP": Parameter(REAL32, 2.5),
        "EKF2_REQ_EPH": Parameter(REAL32, 3.0),
        "EKF2_REQ_EPV": Parameter(REAL32, 5.0),
        "EKF2_REQ_SACC": Parameter(REAL32, 0.5),
        "EKF2_NOAID_TOUT": Parameter(INT32, 5_000_000),
        "CBRK_SUPPLY_CHK": Parameter(INT32, 0),
    }


class Px4(Vehicle):
    """A simulated PX4 multicopter."""

    autopilot = mavlink.MAV_AUTOPILOT_PX4
    capabilities = (
        mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    )
    tasks: ClassVar = {
        OFFBOARD: VehicleTask.OFFBOARD,
        TAKEOFF: VehicleTask.TAKEOFF,
        RETURN: VehicleTask.RETURN,
        LAND: VehicleTask.LAND,
    }
    mode_names: ClassVar = {
        MANUAL: "MANUAL",
        ALTITUDE: "ALTITUDE",
        POSITION: "POSITION",
        OFFBOARD: "OFFBOARD",
        TAKEOFF: "TAKEOFF",
        HOLD: "HOLD",
        MISSION: "MISSION",
        RETURN: "RETURN",
        LAND: "LAND",
    }

    pilot_mode = POSITION

    def __init__(self, system: int, origin: Origin, body: Body, boot: float) -> None:
        super().__init__(system, origin, body, boot)
        self._after_disarming: int = HOLD
        self._battery_reported = 0
        self._requested_takeoff = math.nan

    def make_parameters(self) -> ParameterTable:
        return ParameterTable(_defaults(self.system), bytewise=True)

    def first_mode(self) -> int:
        return HOLD

    def cells(self) -> int:
        return int(self.parameters["BAT1_N_CELLS"])

    def base_mode(self) -> int:
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        if self.mode in _WITH_STICKS:
            return int(flags | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED)
        automatic = mavlink.MAV_MODE_FLAG_AUTO_ENABLED if self.mode != OFFBOARD else 0
        return int(flags | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED | automatic)

    def mode_of(self, message: Message) -> int | None:
        main, sub = message.param2, message.param3
        if not (math.isfinite(main) and 0 < main < 256):
            return None
        return px4_mode(int(main), int(sub) if math.isfinite(sub) and 0 <= sub < 256 else 0)

    def request_mode(self, mode: int) -> int:
        if mode not in self.mode_names or mode == MISSION:
            return int(mavlink.MAV_RESULT_DENIED)
        if self.armed and mode not in _WITHOUT_POSITION and not self.estimator.position_ready:
            return int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
        if mode == OFFBOARD and self.armed and not self._streams():
            return int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
        if mode not in _ENDS:
            self._after_disarming = mode
        if mode != self.mode:
            self.set_mode(mode)
        if mode == OFFBOARD and self.armed and self.setpoint is not None:
            self._fly(self.setpoint)
        if mode == TAKEOFF and self.armed:
            self._begin_takeoff()
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def is_ground_station(self, system: int, kind: int) -> bool:  # noqa: ARG002
        return bool(kind == mavlink.MAV_TYPE_GCS)

    def arming_denials(self) -> list[str]:
        reasons = []
        if not self.estimator.attitude_ready:
            reasons.append("Preflight Fail: ekf2 missing data")
        elif not self.estimator.position_ready and self.mode not in _WITHOUT_POSITION:
            reasons.append("Preflight Fail: " + ("No valid position" if self.estimator.gps_fix else "GPS fix too low"))
        if self.battery.remaining < self.parameters["COM_ARM_BAT_MIN"]:
            reasons.append("Preflight Fail: low battery")
        if self.battery.remaining < self.parameters["BAT_LOW_THR"]:
            reasons.append("Preflight Fail: Low battery level")
        if self.fence_enabled and self._is_outside():
            reasons.append("Preflight Fail: Geofence violation")
        if self.parameters["NAV_DLL_ACT"] and (self.ground_heartbeat is None or self.ground_lost):
            reasons.append("Preflight Fail: No connection to the GCS")
        if self.mode in (*_WITH_STICKS, RETURN, LAND) or (self.mode == OFFBOARD and not self._streams()):
            reasons.append(_NO_TEXT)
        return reasons

    def prearm_denials(self) -> list[str]:
        return self.arming_denials()

    def refuse_arming(self, arming_denials: list[str]) -> int:
        self.say("Arming denied: Resolve system health failures first")
        for reason in filter(None, arming_denials):
            self.say(reason)
        return int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)

    def armed_in_mode(self) -> None:
        if self.mode == TAKEOFF:
            self._begin_takeoff()
        elif self.mode == OFFBOARD and self.setpoint is not None and self._streams():
            self._fly(self.setpoint)

    def command_takeoff(self, altitude: float) -> int:
        if self.phase != Phase.GROUND or (self.armed and not self.estimator.position_ready):
            return int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
        # The command's altitude is above mean sea level here.
        self._requested_takeoff = altitude - self.origin.altitude if math.isfinite(altitude) else math.nan
        self.set_mode(TAKEOFF)
        if self.armed:
            self._begin_takeoff()
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def command_land(self) -> int:
        return self.request_mode(LAND)

    def command_return(self) -> int:
        return self.request_mode(RETURN)

    def obey(self, setpoint: SetpointRequest) -> None:
        self.setpoint = setpoint  # counts as a stream in any mode
        if self.mode == OFFBOARD and self.armed:
            self._fly(setpoint)

    def after_disarming(self) -> None:
        if self.mode in _ENDS:
            self.set_mode(self._after_disarming)

    def took_off(self) -> None:
        if self.mode == TAKEOFF:
            self.set_mode(HOLD)

    def descent(self) -> Descent:
        value = self.parameters
        return Descent(value["MPC_Z_VEL_MAX_DN"], value["MPC_LAND_SPEED"], value["MPC_LAND_ALT2"])

    def return_plan(self) -> ReturnPlan:
        """Return altitude, which rises with the distance from home along a cone up to RTL_RETURN_ALT."""
        value, (x, y, _) = self.parameters, self.body.position
        home = self.home or self.body.position
        away = math.hypot(x - home[0], y - home[1])
        altitude = value["RTL_RETURN_ALT"]
        if away <= _ACCEPTANCE:
            altitude = min(altitude, 2 * away)
        elif away <= value["RTL_MIN_DIST"]:
            cone = math.tan(math.radians(min(max(value["RTL_CONE_ANG"], 1), 89)))
            altitude = max(min(altitude, away / cone), 2 * _ACCEPTANCE)
        return ReturnPlan(altitude, value["MPC_XY_CRUISE"], max(value["RTL_LAND_DELAY"], 0.0))

    def disarm_delays(self) -> tuple[float, float]:
        return self.parameters["COM_DISARM_PRFLT"], self.parameters["COM_DISARM_LAND"]

    def watch(self) -> None:
        self._watch_stream()
        self._watch_ground()
        self._watch_estimator()
        self._watch_battery()
        self._watch_fence()

    def _streams(self) -> bool:
        return self.setpoint is not None and self.time - self.setpoint.time <= self.parameters["COM_OF_LOSS_T"]

    def _fly(self, setpoint: SetpointRequest) -> None:
        if self.phase == Phase.GROUND:
            upwards = (
                setpoint.velocity[2] > 0.1
                if setpoint.velocity
                else bool(setpoint.position and setpoint.position[2] > 0.5)
            )
            if not upwards:
                return
        self.follow_setpoint(setpoint, self.parameters["MPC_XY_VEL_MAX"])

    def _begin_takeoff(self) -> None:
        if self.phase == Phase.GROUND:
            requested = self._requested_takeoff - self.home[2] if self.home else math.nan
            altitude = requested if requested > 0 else self.parameters["MIS_TAKEOFF_ALT"]
            self.take_off(max(altitude, 0.5), self.parameters["MPC_TKO_SPEED"])

    def _watch_stream(self) -> None:
        if self.mode != OFFBOARD or self._streams() or not self.armed:
            return
        self.say("Failsafe activated: Offboard control lost")
        # Without a remote control the manual modes are not available, so the vehicle returns.
        action = {4: LAND, 5: HOLD}.get(int(self.parameters["COM_OBL_RC_ACT"]), RETURN)
        self._fall_back(action)

    def _watch_ground(self) -> None:
        heartbeat, action = self.ground_heartbeat, int(self.parameters["NAV_DLL_ACT"])
        lost = heartbeat is not None and self.time - heartbeat > self.parameters["COM_DL_LOSS_T"]
        if lost == self.ground_lost:
            return
        self.ground_lost = lost
        if lost:
            self.say("Connection to ground station lost", mavlink.MAV_SEVERITY_WARNING)
        if lost and self.armed and action:
            self._fall_back({1: HOLD, 3: LAND}.get(action, RETURN))

    def _watch_estimator(self) -> None:
        blind = not self.estimator.position_ready and self.mode not in (*_WITHOUT_POSITION, LAND)
        if blind and self.phase != Phase.GROUND:
            self.say("Failsafe activated: Position estimate invalid")
            self._fall_back(LAND)

    def _watch_battery(self) -> None:
        left, value = self.battery.remaining, self.parameters
        level = sum(left < value[name] for name in ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR"))
        if level > self._battery_reported and self.armed:
            self.say(("Low battery", "Critical battery", "Dangerous battery")[level - 1])
            action = int(value["COM_LOW_BAT_ACT"])
            if (action == 2 and level >= 2) or (action == 3 and level == 3):
                self._fall_back(LAND)
            elif action == 3 and level == 2:
                self._fall_back(RETURN)
        self._battery_reported = level

    @property
    def fence_enabled(self) -> bool:
        return bool(self.parameters["GF_ACTION"])

    def _is_outside(self) -> bool:
        return self.is_outside_fence(self.parameters["GF_MAX_HOR_DIST"], self.parameters["GF_MAX_VER_DIST"], True)

    def _watch_fence(self) -> None:
        action = int(self.parameters["GF_ACTION"])
        outside = self.fence_enabled and self._is_outside()
        if outside and not self.breached and self.phase != Phase.GROUND:
            self.say("Geofence violation")
            if action > 1:
                self._fall_back({3: RETURN, 5: LAND}.get(action, HOLD))
        self.breached = outside

    def _fall_back(self, mode: int) -> None:
        """Change to a failsafe's mode; disarm on the ground."""
        if self.phase == Phase.GROUND:
            self.disarm(force=False)
            self.set_mode(HOLD)
        elif self.mode not in (LAND, mode):  # a landing is not interrupted
            self.set_mode(mode, failsafe=True)
