"""ArduPilot's JSON interface: motor pulses arrive as UDP datagrams, sensor readings are sent as a line of JSON.

ArduPilot (started with `--model JSON:127.0.0.1`) sends to port 9002 + 10 I for its instance I, waits for the answer,
and advances its clock by it. A datagram has a little-endian u16 magic, u16 rate (Hz), u32 frame count, and 16 pulses of
u16 us (magic 18458) or 32 of them (magic 29569). Without an answer it is repeated each second; each answer advances the
frame count (ArduPilot, libraries/SITL/examples/JSON/readme.md).
"""

from __future__ import annotations

import select
import socket
import struct
import time
from typing import NamedTuple

import numpy as np

from controllers.airframe import ROTORS
from moflock_mj.sitl.interface import STILL, AutopilotInterface, Reading, listening
from moflock_mj.sitl.motors import outputs_of_pwm

BASE_PORT = 9002
PORT_STEP = 10
"""Difference between the ports of two instances."""

RATE = 1200
"""Rate of exchanges, Hz: ArduPilot does not arm if its gyroscopes have a rate below about 720 Hz."""

PWM_MAX = 2200
"""Maximum pulse width of ArduPilot's outputs, us; a longer one is invalid."""

_LAYOUTS = {18458: struct.Struct("<HHI16H"), 29569: struct.Struct("<HHI32H")}
_MAGIC = struct.Struct("<H")
_LARGEST = 256
"""Number of bytes to read of a datagram; every valid one is shorter."""
_REPEAT = 0.5
"""Time after an answer from which a repeated frame means that the answer was lost, s; before, the two crossed."""
_LINE = (
    '\n{"timestamp":%.9f,"imu":{"gyro":[%.9g,%.9g,%.9g],"accel_body":[%.9g,%.9g,%.9g]},"position":[%.6f,%.6f,%.6f],'
    '"quaternion":[%.9g,%.9g,%.9g,%.9g],"velocity":[%.9g,%.9g,%.9g]}\n'
)
"""Line of an answer; ArduPilot reads the text between two line breaks."""


class Pulses(NamedTuple):
    """One datagram of ArduPilot.

    Attributes:
        rate: requested rate of answers, Hz.
        frame: number of accepted answers.
        pwm: pulse widths of motors 1 to 4, us.
    """

    rate: int
    frame: int
    pwm: tuple[int, ...]


def parse_pulses(packet: bytes) -> Pulses | None:
    """Parse a datagram; None if it is invalid."""
    if len(packet) < _MAGIC.size:
        return None
    layout = _LAYOUTS.get(_MAGIC.unpack_from(packet)[0])
    if layout is None or len(packet) != layout.size:
        return None
    _, rate, frame, *pwm = layout.unpack(packet)
    if max(pwm[:ROTORS]) > PWM_MAX:
        return None
    return Pulses(rate, frame, tuple(pwm[:ROTORS]))


def sensor_line(since: float, reading: Reading, drone: int) -> bytes:
    """Line of the answer to a datagram.

    Args:
        since: simulated time at which the autopilot's clock started, s.
        reading: sensor readings of all drones.
        drone: number of the drone.
    """
    motion = reading.motion
    return (
        _LINE
        % (
            reading.time - since,
            *motion.gyro[drone].tolist(),
            *motion.specific_force[drone].tolist(),
            *motion.position[drone].tolist(),
            *motion.attitude[drone].tolist(),
            *motion.velocity[drone].tolist(),
        )
    ).encode()


class ArduPilotLink(AutopilotInterface):
    """Link of the physics to one ArduPilot."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self._socket: socket.socket | None = None
        self._peer: tuple[str, int] | None = None
        self._frame = -1
        self._answer = b""
        self._answered = 0.0
        self._since: float | None = None

    def open(self, port: int) -> None:
        self._socket = listening(socket.SOCK_DGRAM, "UDP", port)
        self._socket.setblocking(False)

    @property
    def port(self) -> int:
        return int(self._opened.getsockname()[1])

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def receive(self, timeout: float) -> None:
        if timeout > 0:
            select.select([self._opened], [], [], timeout)
        while not self.ready:
            try:
                packet, address = self._opened.recvfrom(_LARGEST)
            except BlockingIOError:
                return
            except ConnectionError:
                continue  # an answer was not received: the autopilot has ended
            self._take(packet, address)

    def send_reading(self, reading: Reading) -> None:
        if self._peer is None:
            return
        if self._since is None:
            # The clock of an autopilot that has just started must not begin with a jump.
            self._since = reading.time
        self._answer = sensor_line(self._since, reading, self.number)
        self._answered = time.monotonic()
        self.ready = False
        self._send()

    @property
    def _opened(self) -> socket.socket:
        if self._socket is None:
            raise ValueError("the link is not open")
        return self._socket

    def _take(self, packet: bytes, address: tuple[str, int]) -> None:
        pulses = parse_pulses(packet)
        if pulses is None or (address != self._peer and not self._is_free()):
            self.counts.dropped += 1
            return
        if address == self._peer and pulses.frame == self._frame:
            if time.monotonic() - self._answered > _REPEAT:
                self._send()
                self._answered = time.monotonic()
            return
        if address != self._peer or pulses.frame < self._frame:
            self.counts.restarts += self._peer is not None
            self._since = None
        self._peer, self._frame = address, pulses.frame
        self.outputs = tuple(outputs_of_pwm(np.array(pulses.pwm, float)).tolist())
        self.ready = True
        self.counts.received += 1

    def _is_free(self) -> bool:
        """Whether another program may take this link: there was none before, or it does not answer."""
        return self._peer is None or time.monotonic() - self._answered > _REPEAT

    def _send(self) -> None:
        if self._peer is not None:
            try:
                self._opened.sendto(self._answer, self._peer)
            except OSError:
                self.outputs = STILL  # it has ended, and the lock-step will time out
