"""Handling of the messages that a simulated vehicle receives."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from moflock_mj.mavlink.dialect import Message, mavlink
from moflock_mj.mavlink.frames import Triple, euler_of_quaternion, world_of_ned
from moflock_mj.simulated_vehicles.telemetry import Telemetry
from moflock_mj.simulated_vehicles.vehicle import SetpointRequest, Vehicle

_FORCE = 21196
"""Magic number of a MAV_CMD_COMPONENT_ARM_DISARM that skips the checks."""
_LISTED_AT_ONCE = 4
"""Number of parameters of a list that are sent in one update."""
_FTP_NAK, _FTP_FAIL = 129, 1
_FTP_HEADER = 12

_IGNORE_POSITION, _IGNORE_VELOCITY = 0b111, 0b111000
_LOCAL_FRAMES = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_OFFSET_NED)
_BODY_FRAMES = (mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED)
_PLACE_MAX = 1e6
"""Maximum coordinate of a valid position, m."""


class Command(NamedTuple):
    """A COMMAND_LONG or COMMAND_INT."""

    number: int
    param1: float
    param2: float
    param3: float
    param7: float


class MessageHandler:
    """Handler of the messages that one vehicle receives.

    Args:
        vehicle: vehicle that executes the commands.
        telemetry: telemetry of the vehicle.
        clock: function that returns the time of TIMESYNC, ns.
    """

    def __init__(self, vehicle: Vehicle, telemetry: Telemetry, clock: Callable[[], int]) -> None:
        self._vehicle = vehicle
        self._telemetry = telemetry
        self._clock = clock
        self._listing: dict[object, int] = {}
        self._answers: dict[str, Callable[[Message, object], None]] = {
            "HEARTBEAT": self._heartbeat,
            "COMMAND_LONG": self._command,
            "COMMAND_INT": self._command,
            "SET_MODE": self._set_mode,
            "SET_POSITION_TARGET_LOCAL_NED": self._setpoint,
            "PARAM_REQUEST_READ": self._read_parameter,
            "PARAM_REQUEST_LIST": self._list_parameters,
            "PARAM_SET": self._set_parameter,
            "MISSION_REQUEST_LIST": self._fence,
            "MISSION_REQUEST_INT": self._fence,
            "MISSION_REQUEST": self._fence,
            "MISSION_COUNT": self._fence,
            "MISSION_ITEM_INT": self._fence,
            "MISSION_CLEAR_ALL": self._fence,
            "MISSION_ACK": self._fence,
            "PING": self._ping,
            "TIMESYNC": self._timesync,
            "REQUEST_DATA_STREAM": self._data_stream,
            "FILE_TRANSFER_PROTOCOL": self._refuse_files,
        }
        self._commands: dict[int, Callable[[Command, object], int]] = {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_NAV_TAKEOFF: lambda command, _: vehicle.command_takeoff(command.param7),
            mavlink.MAV_CMD_NAV_LAND: lambda *_: vehicle.command_land(),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda *_: vehicle.command_return(),
            mavlink.MAV_CMD_RUN_PREARM_CHECKS: self._run_prearm_checks,
            mavlink.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._request_capabilities,
            mavlink.MAV_CMD_GET_HOME_POSITION: self._request_home,
            mavlink.MAV_CMD_DO_FENCE_ENABLE: self._enable_fence,
        }

    def answer(self, message: Message, peer: object) -> None:
        """Process a valid message for this vehicle; answers go to its outbox."""
        known = self._answers.get(message.get_type())
        if known:
            known(message, peer)

    def update(self) -> None:
        """Continue to send lists of parameters."""
        names = self._vehicle.parameters
        for peer, first in list(self._listing.items()):
            last = min(first + _LISTED_AT_ONCE, len(names))
            for index in range(first, last):
                self._vehicle.send(names.message(str(names.name(index))), peer)
            if last == len(names):
                del self._listing[peer]
            else:
                self._listing[peer] = last

    def _heartbeat(self, message: Message, peer: object) -> None:  # noqa: ARG002
        if self._vehicle.is_ground_station(message.get_srcSystem(), message.type):
            self._vehicle.note_ground_heartbeat()

    def _command(self, message: Message, peer: object) -> None:
        last = message.param7 if message.get_type() == "COMMAND_LONG" else message.z
        command = Command(message.command, message.param1, message.param2, message.param3, last)
        known = self._commands.get(command.number)
        result = known(command, peer) if known else mavlink.MAV_RESULT_UNSUPPORTED
        acknowledgement = mavlink.MAVLink_command_ack_message(
            message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
        )
        self._vehicle.send(acknowledgement, peer)

    def _arm_disarm(self, command: Command, peer: object) -> int:  # noqa: ARG002
        force = command.param2 == _FORCE
        if command.param1 == 1:
            return self._vehicle.arm(force=force)
        if command.param1 == 0:
            return self._vehicle.disarm(force=force)
        return int(mavlink.MAV_RESULT_DENIED)

    def _run_prearm_checks(self, command: Command, peer: object) -> int:  # noqa: ARG002
        if self._vehicle.armed:
            return int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
        for reason in filter(None, self._vehicle.prearm_denials()):
            self._vehicle.say(reason)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _do_set_mode(self, command: Command, peer: object) -> int:  # noqa: ARG002
        custom = math.isfinite(command.param1) and int(command.param1) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        mode = self._vehicle.mode_of(command)
        if not custom or mode is None:
            return int(mavlink.MAV_RESULT_DENIED)
        return self._vehicle.request_mode(mode)

    def _set_mode(self, message: Message, peer: object) -> None:  # noqa: ARG002
        if message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            self._vehicle.request_mode(message.custom_mode)

    def _set_interval(self, command: Command, peer: object) -> int:  # noqa: ARG002
        number = _message_number(command.param1)
        if number is None or not math.isfinite(command.param2):
            return int(mavlink.MAV_RESULT_DENIED)
        self._telemetry.set_interval(number, command.param2)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _get_interval(self, command: Command, peer: object) -> int:
        number = _message_number(command.param1)
        if number is None or number > 65535:
            return int(mavlink.MAV_RESULT_DENIED)
        interval = self._telemetry.interval(number)
        self._vehicle.send(mavlink.MAVLink_message_interval_message(number, interval), peer)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _request_message(self, command: Command, peer: object) -> int:
        number = _message_number(command.param1)
        message = None if number is None else self._telemetry.make(number)
        if message is None:
            return int(mavlink.MAV_RESULT_FAILED)
        self._vehicle.send(message, peer)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _request_capabilities(self, command: Command, peer: object) -> int:
        return self._request_message(command._replace(param1=mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION), peer)

    def _request_home(self, command: Command, peer: object) -> int:
        return self._request_message(command._replace(param1=mavlink.MAVLINK_MSG_ID_HOME_POSITION), peer)

    def _enable_fence(self, command: Command, peer: object) -> int:  # noqa: ARG002
        if "FENCE_ENABLE" not in self._vehicle.parameters or command.param1 not in (0, 1):
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        self._vehicle.parameters.set_value("FENCE_ENABLE", command.param1)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _setpoint(self, message: Message, peer: object) -> None:  # noqa: ARG002
        vehicle, mask = self._vehicle, message.type_mask
        velocity = position = None
        if not mask & _IGNORE_VELOCITY:
            velocity = self._turned((message.vx, message.vy, message.vz), message.coordinate_frame)
        elif not mask & _IGNORE_POSITION and message.coordinate_frame == mavlink.MAV_FRAME_LOCAL_NED:
            position = self._placed((message.x, message.y, message.z))
        if velocity is not None or position is not None:
            vehicle.obey(SetpointRequest(velocity=velocity, position=position, time=vehicle.time))

    def _turned(self, velocity: Triple, frame: int) -> Triple | None:
        """Convert a velocity from a message's frame to the world; None if it is invalid."""
        north, east, down = velocity
        if not all(math.isfinite(speed) for speed in velocity) or frame not in (*_LOCAL_FRAMES, *_BODY_FRAMES):
            return None
        if frame in _BODY_FRAMES:
            _, _, yaw = euler_of_quaternion(*self._vehicle.body.quaternion)
            forward, right = north, east
            north = forward * math.cos(yaw) - right * math.sin(yaw)
            east = forward * math.sin(yaw) + right * math.cos(yaw)
        return world_of_ned((north, east, down))

    def _placed(self, place: Triple) -> Triple | None:
        """Convert a position from the vehicle's own NED to the world; None if it is invalid."""
        if not all(abs(coordinate) <= _PLACE_MAX for coordinate in place):
            return None
        (x, y, z), origin = world_of_ned(place), self._vehicle.local_origin
        return x + origin[0], y + origin[1], z + origin[2]

    def _read_parameter(self, message: Message, peer: object) -> None:
        parameters = self._vehicle.parameters
        name: str | None = message.param_id if message.param_index < 0 else parameters.name(message.param_index)
        if name is not None and name in parameters:
            self._vehicle.send(parameters.message(name), peer)

    def _list_parameters(self, message: Message, peer: object) -> None:  # noqa: ARG002
        self._listing[peer] = 0

    def _set_parameter(self, message: Message, peer: object) -> None:
        parameters, name = self._vehicle.parameters, message.param_id
        parameters.receive(name, message.param_value, message.param_type)
        if name in parameters:
            # The answer to a refused value contains the old one.
            self._vehicle.send(parameters.message(name), peer)

    def _fence(self, message: Message, peer: object) -> None:
        self._vehicle.fence.receive(message, peer, self._vehicle.time)

    def _ping(self, message: Message, peer: object) -> None:
        if message.target_system == 0:
            sender = (message.get_srcSystem(), message.get_srcComponent())
            self._vehicle.send(mavlink.MAVLink_ping_message(message.time_usec, message.seq, *sender), peer)

    def _timesync(self, message: Message, peer: object) -> None:
        if message.tc1 == 0:
            self._vehicle.send(mavlink.MAVLink_timesync_message(self._clock(), message.ts1), peer)

    def _data_stream(self, message: Message, peer: object) -> None:  # noqa: ARG002
        rate = message.req_message_rate if message.start_stop == 1 else 0
        self._telemetry.set_stream(message.req_stream_id, rate)

    def _refuse_files(self, message: Message, peer: object) -> None:
        """Refuse MAVFTP, since there are no files; without a refusal MAVProxy waits for 11 s."""
        header = bytes(message.payload)[:_FTP_HEADER]
        if len(header) < _FTP_HEADER or header[3] >= 128:
            return  # only requests are answered
        sequence = (int.from_bytes(header[:2], "little") + 1) % 65536
        result = bytes((header[2], _FTP_NAK, 1, header[3], 0, 0, 0, 0, 0, 0, _FTP_FAIL))
        refusal = sequence.to_bytes(2, "little") + result
        sender = (message.get_srcSystem(), message.get_srcComponent())
        payload = list(refusal.ljust(251, b"\0"))
        self._vehicle.send(mavlink.MAVLink_file_transfer_protocol_message(0, *sender, payload), peer)


def _message_number(carried: float) -> int | None:
    """Message id from a float parameter; None if it is invalid."""
    return int(carried) if math.isfinite(carried) and 0 <= carried < 2**24 else None
