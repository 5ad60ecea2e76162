"""A simulated ArduCopter: its modes, parameters, arming and failsafes.

Behaviour and defaults are those of ArduCopter 4.7 (https://ardupilot.org/copter/docs/parameters.html). Measured
peculiarities: a velocity setpoint in GUIDED ends a take-off, without setpoints it hovers and never lands, and most
failsafes are off.
"""

from __future__ import annotations

import math
from typing import ClassVar

from moflock_mj.ground_station.flight_modes import ArduCopterMode
from moflock_mj.mavlink.dialect import GROUND_SYSTEM, Message, mavlink
from moflock_mj.mavlink.frames import Origin
from moflock_mj.mavlink.parameters import INT8, INT16, INT32, REAL32, Parameter
from moflock_mj.simulated_vehicles.guidance import Body
from moflock_mj.simulated_vehicles.parameter_table import ParameterTable
from moflock_mj.simulated_vehicles.vehicle import Descent, Phase, ReturnPlan, SetpointRequest, Vehicle, VehicleTask

STABILIZE, ALT_HOLD, AUTO = ArduCopterMode.STABILIZE, ArduCopterMode.ALT_HOLD, ArduCopterMode.AUTO
GUIDED, LOITER, RTL = ArduCopterMode.GUIDED, ArduCopterMode.LOITER, ArduCopterMode.RTL
LAND, POSHOLD, BRAKE = ArduCopterMode.LAND, ArduCopterMode.POSHOLD, ArduCopterMode.BRAKE
_ARMABLE = (STABILIZE, ALT_HOLD, GUIDED, LOITER, POSHOLD)
_WITHOUT_POSITION = (STABILIZE, ALT_HOLD, LAND)

_FENCE_ALTITUDE, _FENCE_CIRCLE, _FENCE_SHAPES = 1, 2, 4
"""Bits of FENCE_TYPE."""

_PREARM_PERIOD = 30.0
"""Interval at which the reasons against arming are repeated, s."""


def _defaults(system: int) -> dict[str, Parameter]:
    return {
        "SYSID_THISMAV": Parameter(INT16, system),
        "SYSID_MYGCS": Parameter(INT16, GROUND_SYSTEM),
        "FRAME_CLASS": Parameter(INT8, 1),
        "FRAME_TYPE": Parameter(INT8, 1),
        "ARMING_CHECK": Parameter(INT32, 1),
        "ANGLE_MAX": Parameter(INT16, 3000),
        "WPNAV_SPEED": Parameter(REAL32, 1000.0),
        "WPNAV_ACCEL": Parameter(REAL32, 250.0),
        "WPNAV_SPEED_UP": Parameter(REAL32, 250.0),
        "WPNAV_SPEED_DN": Parameter(REAL32, 150.0),
        "WPNAV_RADIUS": Parameter(REAL32, 200.0),
        "LOIT_SPEED": Parameter(REAL32, 1250.0),
        "PILOT_TKOFF_ALT": Parameter(REAL32, 0.0),
        "GUID_TIMEOUT": Parameter(REAL32, 3.0),
        "GUID_OPTIONS": Parameter(INT32, 0),
        "RTL_ALT": Parameter(INT32, 1500),
        "RTL_ALT_FINAL": Parameter(INT16, 0),
        "RTL_CLIMB_MIN": Parameter(INT16, 0),
        "RTL_SPEED": Parameter(INT16, 0),
        "RTL_LOIT_TIME": Parameter(INT32, 5000),
        "LAND_SPEED": Parameter(INT16, 50),
        "LAND_SPEED_HIGH": Parameter(INT16, 0),
        "LAND_ALT_LOW": Parameter(INT16, 1000),
        "DISARM_DELAY": Parameter(INT8, 10),
        "FENCE_ENABLE": Parameter(INT8, 0),
        "FENCE_TYPE": Parameter(INT8, _FENCE_ALTITUDE | _FENCE_CIRCLE | _FENCE_SHAPES),
        "FENCE_ACTION": Parameter(INT8, 1),
        "FENCE_ALT_MAX": Parameter(REAL32, 100.0),
        "FENCE_ALT_MIN": Parameter(REAL32, -10.0),
        "FENCE_RADIUS": Parameter(REAL32, 300.0),
        "FENCE_MARGIN": Parameter(REAL32, 2.0),
        "FENCE_TOTAL": Parameter(INT8, 0),
        "FS_GCS_ENABLE": Parameter(INT8, 0),
        "FS_GCS_TIMEOUT": Parameter(REAL32, 5.0),
        "FS_THR_ENABLE": Parameter(INT8, 1),
        "FS_EKF_ACTION": Parameter(INT8, 1),
        "FS_EKF_THRESH": Parameter(REAL32, 0.8),
        "FS_CRASH_CHECK": Parameter(INT8, 1),
        "BATT_MONITOR": Parameter(INT8, 4),
        "BATT_CAPACITY": Parameter(INT32, 6000),
        "BATT_ARM_VOLT": Parameter(REAL32, 0.0),
        "BATT_ARM_MAH": Parameter(INT32, 0),
        "BATT_LOW_VOLT": Parameter(REAL32, 10.5),
        "BATT_LOW_MAH": Parameter(REAL32, 0.0),
        "BATT_LOW_TIMER": Parameter(INT8, 10),
        "BATT_CRT_VOLT": Parameter(REAL32, 0.0),
        "BATT_CRT_MAH": Parameter(REAL32, 0.0),
        "BATT_FS_LOW_ACT": Parameter(INT8, 0),
        "BATT_FS_CRT_ACT": Parameter(INT8, 0),
        "EK3_ENABLE": Parameter(INT8, 1),
        "AHRS_EKF_TYPE": Parameter(INT8, 3),
        "GPS_HDOP_GOOD": Parameter(INT16, 140),
        "AVOID_ENABLE": Parameter(INT8, 3),
        "SERIAL0_PROTOCOL": Parameter(INT8, 2),
    }


class ArduCopter(Vehicle):
    """A simulated ArduCopter."""

    autopilot = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    capabilities = (
        mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    )
    tasks: ClassVar = {GUIDED: VehicleTask.OFFBOARD, RTL: VehicleTask.RETURN, LAND: VehicleTask.LAND}
    mode_names: ClassVar = {
        STABILIZE: "STABILIZE",
        ALT_HOLD: "ALT_HOLD",
        AUTO: "AUTO",
        GUIDED: "GUIDED",
        LOITER: "LOITER",
        RTL: "RTL",
        LAND: "LAND",
        POSHOLD: "POSHOLD",
        BRAKE: "BRAKE",
    }

    pilot_mode = LOITER

    def __init__(self, system: int, origin: Origin, body: Body, boot: float) -> None:
        super().__init__(system, origin, body, boot)
        self._low_since = 0.0
        self._low_reported = 0
        self._prearm_reported = 0.0

    def make_parameters(self) -> ParameterTable:
        return ParameterTable(_defaults(self.system), bytewise=False)

    def first_mode(self) -> int:
        return STABILIZE

    def cells(self) -> int:
        return 3

    def base_mode(self) -> int:
        flags = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        flags |= mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        return int(flags | (0 if self.mode in (STABILIZE, ALT_HOLD) else mavlink.MAV_MODE_FLAG_GUIDED_ENABLED))

    def mode_of(self, message: Message) -> int | None:
        return int(message.param2) if math.isfinite(message.param2) and 0 <= message.param2 < 256 else None

    def request_mode(self, mode: int) -> int:
        if mode not in self.mode_names:
            return int(mavlink.MAV_RESULT_FAILED)
        if self.armed and mode not in _WITHOUT_POSITION and not self.estimator.position_ready:
            self.say(f"Mode change to {self.mode_names[mode]} failed: requires position")
            return int(mavlink.MAV_RESULT_FAILED)
        if self.armed and mode == AUTO:
            self.say("Mode change to AUTO failed: missing takeoff cmd")
            return int(mavlink.MAV_RESULT_FAILED)
        if mode != self.mode:
            self.set_mode(mode)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def is_ground_station(self, system: int, kind: int) -> bool:  # noqa: ARG002
        return system == self.parameters["SYSID_MYGCS"]

    def arming_denials(self) -> list[str]:
        reasons = self.prearm_denials()
        if self.mode not in _ARMABLE:
            reasons.append(f"Arm: {self.mode_names[self.mode]} mode not armable")
        if self.mode not in _WITHOUT_POSITION and not self.estimator.position_ready:
            reasons.append("Arm: Need Position Estimate")
        return reasons

    def prearm_denials(self) -> list[str]:
        """Reasons of the pre-arm bit, fewer than for arming: it was measured healthy long before the position."""
        reasons, battery = [], self.battery
        if not self.estimator.attitude_ready:
            reasons.append("PreArm: AHRS: waiting for home")
        elif not self.estimator.gps_fix and self.mode not in _WITHOUT_POSITION:
            reasons.append("PreArm: GPS 1: Bad fix")
        if battery.voltage < self.parameters["BATT_ARM_VOLT"]:
            reasons.append("PreArm: Battery 1 below minimum arming voltage")
        if self._battery_level():
            reasons.append("PreArm: Battery 1 low voltage failsafe")
        if self.fence_enabled and self._is_outside():
            reasons.append("PreArm: Vehicle outside fence")
        if self.ground_lost:
            reasons.append("PreArm: GCS failsafe on")
        return reasons

    def refuse_arming(self, arming_denials: list[str]) -> int:
        for reason in arming_denials:
            self.say(reason)
        return int(mavlink.MAV_RESULT_FAILED)

    def armed_in_mode(self) -> None:
        """No-op: it waits for a take-off command."""

    def took_off(self) -> None:
        """No-op: it hovers in GUIDED."""

    def command_takeoff(self, altitude: float) -> int:
        ready = self.armed and self.mode == GUIDED and self.phase == Phase.GROUND
        if not ready or not math.isfinite(altitude) or altitude <= 0:
            return int(mavlink.MAV_RESULT_FAILED)
        self.take_off(altitude, self.parameters["WPNAV_SPEED_UP"] / 100)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def command_land(self) -> int:
        return self.request_mode(LAND)

    def command_return(self) -> int:
        return self.request_mode(RTL)

    def obey(self, setpoint: SetpointRequest) -> None:
        if self.mode != GUIDED or self.phase == Phase.GROUND or not self.armed:
            return  # a setpoint does not start a take-off
        self.setpoint = setpoint
        self.follow_setpoint(setpoint, self.parameters["WPNAV_SPEED"] / 100)

    def descent(self) -> Descent:
        high = self.parameters["LAND_SPEED_HIGH"] or self.parameters["WPNAV_SPEED_DN"]
        return Descent(high / 100, self.parameters["LAND_SPEED"] / 100, self.parameters["LAND_ALT_LOW"] / 100)

    def return_plan(self) -> ReturnPlan:
        speed = self.parameters["RTL_SPEED"] or self.parameters["WPNAV_SPEED"]
        wait = self.parameters["RTL_LOIT_TIME"] / 1000
        return ReturnPlan(self.parameters["RTL_ALT"] / 100, speed / 100, wait)

    def disarm_delays(self) -> tuple[float, float]:
        return self.parameters["DISARM_DELAY"], 0.5

    def watch(self) -> None:
        self._repeat_denials()
        self._watch_setpoints()
        self._watch_ground()
        self._watch_estimator()
        self._watch_battery()
        self._watch_fence()

    def _repeat_denials(self) -> None:
        if not self.armed and self.time - self._prearm_reported >= _PREARM_PERIOD:
            self._prearm_reported = self.time
            for reason in self.prearm_denials():
                self.say(reason)

    def _watch_setpoints(self) -> None:
        setpoint, timeout = self.setpoint, self.parameters["GUID_TIMEOUT"]
        if setpoint is not None and setpoint.velocity is not None and self.time - setpoint.time > timeout:
            self.setpoint = None
            if self.mode == GUIDED and self.phase == Phase.AIR:
                self.hold()

    def _watch_ground(self) -> None:
        heartbeat, action = self.ground_heartbeat, int(self.parameters["FS_GCS_ENABLE"])
        lost = bool(action) and heartbeat is not None and self.time - heartbeat > self.parameters["FS_GCS_TIMEOUT"]
        if lost == self.ground_lost:
            return
        self.ground_lost = lost
        if not lost:
            self.say("GCS Failsafe Cleared", mavlink.MAV_SEVERITY_WARNING)
        elif self.armed:
            self.say("GCS Failsafe", mavlink.MAV_SEVERITY_WARNING)
            self._fall_back({5: LAND, 7: BRAKE}.get(action, RTL))

    def _watch_estimator(self) -> None:
        blind = not self.estimator.position_ready and self.mode not in _WITHOUT_POSITION
        if blind and self.phase != Phase.GROUND and self.parameters["FS_EKF_ACTION"]:
            self.say("EKF Failsafe: changed to LAND Mode")
            self._fall_back(LAND)

    def _battery_level(self) -> int:
        """Battery level: 0 for enough charge, 1 for low, 2 for critical."""
        volts, left = self.battery.voltage, self.battery.remaining * self.battery.capacity
        if volts < self.parameters["BATT_CRT_VOLT"] or left < self.parameters["BATT_CRT_MAH"]:
            return 2
        return int(volts < self.parameters["BATT_LOW_VOLT"] or left < self.parameters["BATT_LOW_MAH"])

    def _watch_battery(self) -> None:
        level = self._battery_level()
        if not level:
            self._low_since, self._low_reported = self.time, 0
        elif (
            level > self._low_reported
            and self.armed
            and self.time - self._low_since >= self.parameters["BATT_LOW_TIMER"]
        ):
            self._low_reported = level
            self.say(
                f"Battery 1 is {'low' if level == 1 else 'critical'} {self.battery.voltage:.2f}V used "
                f"{self.battery.used:.0f} mAh",
                mavlink.MAV_SEVERITY_WARNING,
            )
            action = int(self.parameters["BATT_FS_LOW_ACT" if level == 1 else "BATT_FS_CRT_ACT"])
            if action:
                self._fall_back(RTL if action in (2, 3) else LAND)

    @property
    def fence_enabled(self) -> bool:
        return bool(self.parameters["FENCE_ENABLE"])

    def _is_outside(self) -> bool:
        kinds, value = int(self.parameters["FENCE_TYPE"]), self.parameters
        radius = value["FENCE_RADIUS"] if kinds & _FENCE_CIRCLE else 0.0
        altitude = value["FENCE_ALT_MAX"] if kinds & _FENCE_ALTITUDE else 0.0
        return self.is_outside_fence(radius, altitude, bool(kinds & _FENCE_SHAPES))

    def _watch_fence(self) -> None:
        outside = self.fence_enabled and self.armed and self._is_outside()
        if outside and not self.breached and self.phase != Phase.GROUND:
            self.say("Fence Breached", mavlink.MAV_SEVERITY_NOTICE)
            action = int(self.parameters["FENCE_ACTION"])
            if action:
                self._fall_back({2: LAND, 4: BRAKE}.get(action, RTL))
        self.breached = outside

    def _fall_back(self, mode: int) -> None:
        """Change to a failsafe's mode, or to LAND without a position; disarm on the ground."""
        if self.phase == Phase.GROUND:
            self.disarm(force=False)
            return
        if mode in (RTL, BRAKE) and not self.estimator.position_ready:
            mode = LAND
        if self.mode not in (LAND, mode):  # a landing is not interrupted
            self.set_mode(mode, failsafe=True)
