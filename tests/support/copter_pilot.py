"""Ground station for one real ArduCopter on its TCP port, for tests that have one."""

from __future__ import annotations

import select
import socket
import time

from moflock_mj.mavlink.dialect import GROUND_SYSTEM, mavlink

GUIDED, LAND = 4, 9
POSITION_USABLE = mavlink.EKF_POS_HORIZ_ABS
_STREAMS = {
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 10,
}
"""Rates of the requested messages, Hz."""


class CopterPilot:
    """Ground station for the autopilot with a system id at a TCP port of this machine.

    Attributes:
        last: latest message of each type.
        texts: status texts so far.
    """

    def __init__(self, port: int, system: int):
        self.system, self.last, self.texts = system, {}, []
        deadline = time.monotonic() + 60.0
        while True:
            try:
                self.socket = socket.create_connection(("127.0.0.1", port), 1.0)
                break
            except OSError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.2)
        self.packer = mavlink.MAVLink(None, srcSystem=GROUND_SYSTEM, srcComponent=mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self.decoder = mavlink.MAVLink(None)
        self.decoder.robust_parsing = True
        self._last_heartbeat = 0.0

    def close(self):
        self.socket.close()

    def send(self, message):
        self.socket.sendall(message.pack(self.packer))
        self.packer.seq = (self.packer.seq + 1) % 256

    def pump(self, seconds: float, setpoint=None):
        """Receive for some seconds, sending heartbeats and `setpoint` at 20 Hz; return the received positions."""
        positions, end, due = [], time.monotonic() + seconds, 0.0
        while time.monotonic() < end:
            now = time.monotonic()
            if now - self._last_heartbeat > 1.0:
                self._last_heartbeat = now
                self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            if setpoint is not None and now >= due:
                due = now + 0.05
                self.send(setpoint)
            if not select.select([self.socket], [], [], 0.02)[0]:
                continue
            for message in self.decoder.parse_buffer(self.socket.recv(65536)) or ():
                kind = message.get_type()
                if message.get_srcSystem() != self.system or kind == "BAD_DATA":
                    continue
                self.last[kind] = message
                if kind == "STATUSTEXT":
                    self.texts.append(message.text)
                elif kind == "LOCAL_POSITION_NED":
                    positions.append(message)
        return positions

    def until(self, condition, seconds: float, what: str):
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, f"{what}: {self.texts[-8:]}"
            self.pump(0.2)

    def command(self, number: int, *params: float) -> bool:
        """Send a command and return whether it was accepted."""
        self.last.pop("COMMAND_ACK", None)
        self.send(mavlink.MAVLink_command_long_message(self.system, 1, number, 0, *params, *[0.0] * (7 - len(params))))
        deadline = time.monotonic() + 3.0
        while time.monotonic() < deadline:
            self.pump(0.1)
            answer = self.last.get("COMMAND_ACK")
            if answer is not None and answer.command == number:
                return answer.result == mavlink.MAV_RESULT_ACCEPTED
        return False

    def wait_until_ready(self):
        """Wait until the vehicle has a position and its pre-arm checks pass."""
        self.until(lambda: "HEARTBEAT" in self.last, 60.0, "no heartbeat")
        for message, rate in _STREAMS.items():
            assert self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message, 1e6 / rate)

        def ready():
            status, estimator = self.last.get("SYS_STATUS"), self.last.get("EKF_STATUS_REPORT")
            healthy = status and status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK
            return healthy and estimator and estimator.flags & POSITION_USABLE

        self.until(ready, 180.0, "not ready to arm")

    def take_off(self, height: float):
        self.until(lambda: self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, GUIDED), 10.0, "GUIDED")
        self.until(lambda: self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1), 30.0, "arming")
        assert self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height), self.texts[-5:]

    def height(self) -> float:
        return -self.last["LOCAL_POSITION_NED"].z

    def fly_velocity(self, north: float, east: float, seconds: float):
        """Stream a velocity setpoint and return the received positions."""
        setpoint = mavlink.MAVLink_set_position_target_local_ned_message(
            0, self.system, 1, mavlink.MAV_FRAME_LOCAL_NED, 0xDC7, 0, 0, 0, north, east, 0, 0, 0, 0, 0, 0
        )
        return self.pump(seconds, setpoint)

    def land(self):
        assert self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, LAND)

    def armed(self) -> bool:
        return bool(self.last["HEARTBEAT"].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
