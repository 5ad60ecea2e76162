"""Telemetry of a simulated vehicle: its messages and their rates."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from moflock_mj.mavlink.dialect import SIMULATED, Message, mavlink
from moflock_mj.mavlink.frames import euler_of_quaternion, frd_of_flu, ned_of_world, quaternion_of_euler
from moflock_mj.simulated_vehicles.vehicle import Phase, Vehicle

HEARTBEAT_PERIOD = 1.0
"""Interval of heartbeats, s."""

_STREAMS: dict[int, tuple[int, ...]] = {
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
        mavlink.MAVLINK_MSG_ID_FENCE_STATUS,
    ),
    mavlink.MAV_DATA_STREAM_POSITION: (
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    ),
    mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    mavlink.MAV_DATA_STREAM_EXTRA2: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    mavlink.MAV_DATA_STREAM_EXTRA3: (
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
    ),
}
"""Messages that ArduPilot sends for each stream of REQUEST_DATA_STREAM."""

_PX4_RATES = {
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 20.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 50.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 5.0,
}
"""Rates of the messages that PX4 sends by default, Hz."""

_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_GEOFENCE
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)


class Telemetry:
    """Periodic messages of one vehicle, the same for all its peers, as on one serial port.

    Args:
        vehicle: the vehicle.
        unix_start: Unix time of power-on, s.
    """

    def __init__(self, vehicle: Vehicle, unix_start: float) -> None:
        self._vehicle = vehicle
        self._unix_start = unix_start
        self._periods: dict[int, float] = {}
        self._due: dict[int, float] = {}
        self._heartbeat_due = 0.0
        self._announced: object = None
        self._makers: dict[int, Callable[[], Message | None]] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self.heartbeat,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: self._system_time,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw_int,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self._attitude_quaternion,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position_ned,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position_int,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: self._vfr_hud,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: self._battery_status,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._autopilot_version,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home_position,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._gps_global_origin,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._extended_sys_state,
            mavlink.MAVLINK_MSG_ID_FENCE_STATUS: self._fence_status,
        }
        if vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4:
            self._makers[mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS] = self._estimator_status
            self._periods = {number: 1 / rate for number, rate in _PX4_RATES.items()}
        else:
            self._makers[mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT] = self._ekf_status_report
        self._defaults = dict(self._periods)

    def make(self, number: int) -> Message | None:
        """Make the present message of an id; None if it has no content yet, or is unknown."""
        maker = self._makers.get(number)
        return maker() if maker else None

    def set_interval(self, number: int, microseconds: float) -> None:
        """Set the interval of a message, us; -1 for never, 0 for the default."""
        self._periods.pop(number, None)
        self._due.pop(number, None)
        if microseconds > 0 and number in self._makers:
            self._periods[number] = microseconds / 1e6
        elif microseconds == 0 and number in self._defaults:
            self._periods[number] = self._defaults[number]

    def interval(self, number: int) -> int:
        """Interval of a message, us; -1 for a message that is not sent periodically."""
        period = self._periods.get(number)
        return -1 if period is None else min(round(period * 1e6), 2**31 - 1)

    def set_stream(self, stream: int, rate: float) -> None:
        """Set the rate of the messages of a REQUEST_DATA_STREAM, Hz; 0 for never."""
        numbers = _STREAMS.get(stream, ())
        if stream == mavlink.MAV_DATA_STREAM_ALL:
            numbers = tuple(number for members in _STREAMS.values() for number in members)
        for number in numbers:
            self.set_interval(number, 1e6 / rate if rate > 0 else -1)

    def due(self) -> list[Message]:
        """Messages that are due now."""
        vehicle, now = self._vehicle, self._vehicle.time + 1e-6
        messages = []
        state = (vehicle.mode, vehicle.armed, vehicle.failsafe)
        if now >= self._heartbeat_due or state != self._announced:
            self._announced, self._heartbeat_due = state, vehicle.time + HEARTBEAT_PERIOD
            messages.append(self.heartbeat())
        for number, period in self._periods.items():
            due = self._due.get(number, 0.0)
            if now >= due:
                self._due[number] = due + period if due + period > now else vehicle.time + period
                message = self._makers[number]()
                if message is not None:
                    messages.append(message)
        return messages

    def heartbeat(self) -> Message:
        vehicle = self._vehicle
        status = mavlink.MAV_STATE_ACTIVE if vehicle.armed else mavlink.MAV_STATE_STANDBY
        if vehicle.failsafe:
            status = mavlink.MAV_STATE_CRITICAL
        if not vehicle.estimator.attitude_ready:
            status = mavlink.MAV_STATE_CALIBRATING
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if vehicle.armed else 0
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, vehicle.autopilot, vehicle.base_mode() | armed, vehicle.mode, status, 3
        )

    def _milliseconds(self) -> int:
        return int(self._vehicle.time * 1000) % 2**32

    def _microseconds(self) -> int:
        return int(self._vehicle.time * 1e6)

    def _sys_status(self) -> Message:
        vehicle = self._vehicle
        battery, present = vehicle.battery, _SENSORS
        if vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4:
            present &= ~(mavlink.MAV_SYS_STATUS_PREARM_CHECK | mavlink.MAV_SYS_STATUS_GEOFENCE)
        enabled = present
        if not vehicle.fence_enabled:
            enabled &= ~mavlink.MAV_SYS_STATUS_GEOFENCE
        healthy = enabled
        if not vehicle.estimator.gps_fix:
            healthy &= ~mavlink.MAV_SYS_STATUS_SENSOR_GPS
        if not vehicle.estimator.attitude_ready:
            healthy &= ~mavlink.MAV_SYS_STATUS_AHRS
        if vehicle.breached:
            healthy &= ~mavlink.MAV_SYS_STATUS_GEOFENCE
        healthy &= ~mavlink.MAV_SYS_STATUS_PREARM_CHECK
        if not vehicle.prearm_denials():
            # PX4 sets this bit in the healthy field only.
            healthy |= mavlink.MAV_SYS_STATUS_PREARM_CHECK
        if vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4:
            # There is no remote control, and PX4 reports the missing receiver as enabled.
            enabled |= mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
        return mavlink.MAVLink_sys_status_message(
            present, enabled, healthy, 300, round(battery.voltage * 1000), round(battery.current * 100),
            round(battery.remaining * 100), 0, 0, 0, 0, 0, 0,
        )  # fmt: skip

    def _system_time(self) -> Message:
        unix = int((self._unix_start + self._vehicle.time) * 1e6)
        return mavlink.MAVLink_system_time_message(unix, self._milliseconds())

    def _globe(self) -> tuple[int, int, int]:
        """Latitude and longitude in 1e-7 degrees, altitude above mean sea level in mm."""
        return self._place_on_globe(self._vehicle.body.position)

    def _place_on_globe(self, place: tuple[float, float, float]) -> tuple[int, int, int]:
        origin = self._vehicle.origin
        latitude, longitude = origin.globe(place[0], place[1])
        return round(latitude * 1e7), round(longitude * 1e7), _bounded((origin.altitude + place[2]) * 1000, 32)

    def _gps_raw_int(self) -> Message:
        fix, body = self._vehicle.estimator.gps_fix, self._vehicle.body
        if not fix:
            return mavlink.MAVLink_gps_raw_int_message(
                self._microseconds(), mavlink.GPS_FIX_TYPE_NO_FIX, 0, 0, 0, 65535, 65535, 65535, 65535, 0
            )
        course = math.degrees(math.atan2(body.velocity[0], body.velocity[1])) % 360
        return mavlink.MAVLink_gps_raw_int_message(
            self._microseconds(), mavlink.GPS_FIX_TYPE_3D_FIX, *self._globe(), 80, 120,
            min(round(body.speed * 100), 65535), round(course * 100) % 36000, 12, 0, 600, 900, 200,
        )  # fmt: skip

    def _rates(self) -> tuple[float, float, float]:
        return frd_of_flu(self._vehicle.body.rates)

    def _attitude(self) -> Message:
        angles = euler_of_quaternion(*self._vehicle.body.quaternion)
        return mavlink.MAVLink_attitude_message(self._milliseconds(), *angles, *self._rates())

    def _attitude_quaternion(self) -> Message:
        turn = quaternion_of_euler(*euler_of_quaternion(*self._vehicle.body.quaternion))
        return mavlink.MAVLink_attitude_quaternion_message(self._milliseconds(), *turn, *self._rates())

    def _local(self, place: tuple[float, float, float]) -> tuple[float, float, float]:
        """Position in NED from the vehicle's own origin, m."""
        x, y, z = self._vehicle.local_origin
        return ned_of_world((place[0] - x, place[1] - y, place[2] - z))

    def _local_position_ned(self) -> Message | None:
        body = self._vehicle.body
        if self._vehicle.home is None:
            return None
        return mavlink.MAVLink_local_position_ned_message(
            self._milliseconds(), *self._local(body.position), *ned_of_world(body.velocity)
        )

    def _global_position_int(self) -> Message | None:
        vehicle = self._vehicle
        if vehicle.home is None:
            return None
        north, east, down = (_bounded(speed * 100, 16) for speed in ned_of_world(vehicle.body.velocity))
        return mavlink.MAVLink_global_position_int_message(
            self._milliseconds(), *self._globe(), _bounded(vehicle.height() * 1000, 32), north, east, down,
            self._heading() * 100 % 36000,
        )  # fmt: skip

    def _heading(self) -> int:
        """Heading, degrees, from 0 to 359."""
        _, _, yaw = euler_of_quaternion(*self._vehicle.body.quaternion)
        return round(math.degrees(yaw)) % 360

    def _vfr_hud(self) -> Message:
        vehicle = self._vehicle
        throttle = 0 if vehicle.phase == Phase.GROUND else 50
        speed, climb = vehicle.body.speed, vehicle.body.velocity[2]
        altitude = vehicle.origin.altitude + vehicle.body.position[2]
        return mavlink.MAVLink_vfr_hud_message(speed, speed, self._heading(), throttle, altitude, climb)

    def _battery_status(self) -> Message:
        battery = self._vehicle.battery
        per_cell = round(battery.voltage / battery.cells * 1000)
        cells = [per_cell] * battery.cells + [65535] * (10 - battery.cells)
        state = mavlink.MAV_BATTERY_CHARGE_STATE_OK
        if battery.remaining < 0.15:
            state = mavlink.MAV_BATTERY_CHARGE_STATE_LOW
        if battery.remaining < 0.07:
            state = mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL
        seconds = round(battery.remaining * battery.capacity * 3.6 / battery.current) if battery.current else 0
        return mavlink.MAVLink_battery_status_message(
            0, mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_LIPO, 2500, cells,
            round(battery.current * 100), round(battery.used), -1, round(battery.remaining * 100), seconds, state,
        )  # fmt: skip

    def _autopilot_version(self) -> Message:
        version = (1 << 24 | 17 << 16) if self._vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4 else (4 << 24 | 7 << 16)
        unset: Any = [0] * 8
        return mavlink.MAVLink_autopilot_version_message(
            self._vehicle.capabilities, version, version, 0, 0, unset, list(SIMULATED), unset, 0, 0,
            self._vehicle.system,
        )  # fmt: skip

    def _home_position(self) -> Message | None:
        home = self._vehicle.home
        if home is None:
            return None
        return mavlink.MAVLink_home_position_message(
            *self._place_on_globe(home), *self._local(home), [1, 0, 0, 0], 0, 0, 0, self._microseconds()
        )

    def _gps_global_origin(self) -> Message | None:
        if self._vehicle.home is None:
            return None
        place = self._place_on_globe(self._vehicle.local_origin)
        return mavlink.MAVLink_gps_global_origin_message(*place, self._microseconds())

    def _extended_sys_state(self) -> Message:
        return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, int(self._vehicle.phase))

    def _fence_status(self) -> Message:
        breached = self._vehicle.breached
        kind = mavlink.FENCE_BREACH_BOUNDARY if breached else mavlink.FENCE_BREACH_NONE
        return mavlink.MAVLink_fence_status_message(int(breached), int(breached), kind, self._milliseconds())

    def _ekf_status_report(self) -> Message:
        estimator = self._vehicle.estimator
        variance = min(estimator.variance, 10.0)
        return mavlink.MAVLink_ekf_status_report_message(estimator.flags, variance, variance, 0.05, 0.05, 0.0)

    def _estimator_status(self) -> Message:
        estimator = self._vehicle.estimator
        ratio = min(estimator.variance, 10.0)
        accuracy = 8 * ratio  # 0.4 m with GPS
        # PX4 sets the constant-position flag of a vehicle at rest.
        still = mavlink.ESTIMATOR_CONST_POS_MODE if self._vehicle.phase == Phase.GROUND else 0
        return mavlink.MAVLink_estimator_status_message(
            self._microseconds(), estimator.flags | still, ratio, ratio, 0.05, 0.05, 0.0, 0.0, accuracy, 0.5
        )


def _bounded(value: float, bits: int) -> int:
    """Round a value and limit it to the range of a signed field."""
    limit = 2 ** (bits - 1)
    return int(min(max(round(value), -limit), limit - 1))
