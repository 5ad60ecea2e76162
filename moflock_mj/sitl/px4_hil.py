"""PX4's simulator interface: MAVLink over TCP, on which the simulator listens and PX4 connects.

PX4's instance i connects to port 4560 + i. It receives HIL_SENSOR, which advances its clock, and HIL_GPS. Once its
controllers run, it answers each HIL_SENSOR with HIL_ACTUATOR_CONTROLS; before that, the simulation does not wait (PX4
guide, Simulation, MAVLink API).
"""

from __future__ import annotations

import math
import select
import socket
import time
from typing import Any

from controllers.airframe import ROTORS
from moflock_mj.mavlink.dialect import Message, mavlink
from moflock_mj.sitl.interface import STILL, AutopilotInterface, Reading, listening
from moflock_mj.sitl.sensors import Surroundings

BASE_PORT = 4560
RATE = 250
"""Rate of HIL_SENSOR, Hz: the IMU_INTEG_RATE that PX4's start-up script sets for simulation."""

GPS_RATE = 10
"""Rate of HIL_GPS, Hz."""
SURROUNDINGS_RATE = 50
"""Rate of magnetometer and barometer in HIL_SENSOR, Hz."""

_INERTIAL = 0b111111
_MAGNETIC = 0b111000000
_PRESSURE = 0b1101000000000
"""Bits of HIL_SENSOR.fields_updated: xacc to zgyro; xmag to zmag; abs_pressure, pressure_alt and temperature."""
_LOCK_STEP = 1
"""Bit of HIL_ACTUATOR_CONTROLS.flags: PX4's clock is that of the last HIL_SENSOR."""
_SATELLITES, _FIX_3D = 12, 3
_EPH, _EPV = 50, 80
"""Horizontal and vertical accuracy in HIL_GPS of a good receiver, cm."""
_CHUNK = 4096
_REPEAT = 0.5
"""Time without an answer after which a message is repeated, s: PX4 can miss it while it starts modules."""


class Px4Link(AutopilotInterface):
    """Link of the physics to one PX4."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self._server: socket.socket | None = None
        self._stream: socket.socket | None = None
        self._decoder: Any = None
        self._packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=mavlink.MAV_COMP_ID_SYSTEM_CONTROL)
        self._answers = False
        self._tick = 0
        self._packets = b""
        self._sent_at = 0.0

    def open(self, port: int) -> None:
        self._server = listening(socket.SOCK_STREAM, "TCP", port)
        self._server.listen(1)
        self._server.setblocking(False)

    @property
    def port(self) -> int:
        return int(self._opened.getsockname()[1])

    def close(self) -> None:
        self._disconnect()
        if self._server is not None:
            self._server.close()
            self._server = None

    def receive(self, timeout: float) -> None:
        if self._stream is None:
            self._accept(timeout)
            return
        if timeout > 0 and not self.ready:
            select.select([self._stream], [], [], timeout)
        while self._stream is not None:
            try:
                chunk = self._stream.recv(_CHUNK)
            except BlockingIOError:
                break
            except ConnectionError:
                chunk = b""
            if not chunk:
                self._disconnect()
                return
            self._parse(chunk)
        if not self.ready and time.monotonic() - self._sent_at > _REPEAT:
            self._send()

    def send_reading(self, reading: Reading) -> None:
        if self._stream is None:
            return
        self._tick += 1
        surroundings = reading.surroundings() if self._tick % (RATE // SURROUNDINGS_RATE) == 1 else None
        self._packets = self._pack(sensor_message(self._tick, reading, self.number, surroundings))
        if self._tick % (RATE // GPS_RATE) == 1:
            self._packets += self._pack(gps_message(self._tick, reading, self.number))
        self.ready = not self._answers
        self._send()

    @property
    def _opened(self) -> socket.socket:
        if self._server is None:
            raise ValueError("the link is not open")
        return self._server

    def _accept(self, timeout: float) -> None:
        if timeout > 0:
            select.select([self._opened], [], [], timeout)
        try:
            stream, _ = self._opened.accept()
        except (BlockingIOError, ConnectionError):
            return
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        stream.setblocking(False)
        self._stream, self._decoder = stream, mavlink.MAVLink(None)
        self._decoder.robust_parsing = True
        self.counts.restarts += self._tick > 0
        self._answers, self._tick = False, 0
        self.outputs, self.ready = STILL, True

    def _disconnect(self) -> None:
        if self._stream is not None:
            self._stream.close()
        self._stream, self.outputs, self.ready = None, STILL, False

    def _send(self) -> None:
        self._sent_at = time.monotonic()
        if self._stream is not None:
            try:
                self._stream.sendall(self._packets)
            except OSError:
                self._disconnect()

    def _parse(self, chunk: bytes) -> None:
        for message in self._decoder.parse_buffer(chunk) or ():
            kind = message.get_type()
            if kind == "HIL_ACTUATOR_CONTROLS":
                self._take(message)
            elif kind == "BAD_DATA":
                self.counts.dropped += 1

    def _take(self, message: Message) -> None:
        outputs = message.controls[:ROTORS]
        if not all(math.isfinite(output) for output in outputs):
            self.counts.dropped += 1
            return
        self.outputs = tuple(min(max(output, 0.0), 1.0) for output in outputs)
        # An answer to an earlier HIL_SENSOR, before PX4 was waited for, would delay the motors permanently.
        late = message.flags & _LOCK_STEP and message.time_usec < microseconds(self._tick)
        self._answers = True
        self.ready |= not late
        self.counts.received += 1

    def _pack(self, message: Message) -> bytes:
        packet: bytes = message.pack(self._packer)
        self._packer.seq = (self._packer.seq + 1) % 256
        return packet


def microseconds(tick: int) -> int:
    """PX4's clock at a HIL_SENSOR, whose numbers start at 1, us."""
    return tick * (1_000_000 // RATE)


def sensor_message(tick: int, reading: Reading, drone: int, surroundings: Surroundings | None) -> Message:
    """HIL_SENSOR of a drone.

    Args:
        tick: number of the message, from 1.
        reading: sensor readings of all drones.
        drone: number of the drone.
        surroundings: readings of magnetometer and barometer, or None.
    """
    fields = _INERTIAL
    field, pressure, altitude, temperature = [0.0, 0.0, 0.0], 0.0, 0.0, 0.0
    if surroundings is not None:
        fields |= _MAGNETIC | _PRESSURE
        field = surroundings.magnetic_field[drone].tolist()
        pressure = float(surroundings.pressure[drone]) / 100
        altitude = float(surroundings.pressure_altitude[drone])
        temperature = float(surroundings.temperature[drone])
    motion = reading.motion
    return mavlink.MAVLink_hil_sensor_message(
        microseconds(tick),
        *motion.specific_force[drone].tolist(),
        *motion.gyro[drone].tolist(),
        *field,
        pressure,
        0.0,
        altitude,
        temperature,
        fields,
        0,
    )


def gps_message(tick: int, reading: Reading, drone: int) -> Message:
    """HIL_GPS of a drone.

    Args:
        tick: number of the accompanying HIL_SENSOR.
        reading: sensor readings of all drones.
        drone: number of the drone.
    """
    north, east, down = reading.motion.position[drone].tolist()
    velocity = reading.motion.velocity[drone].tolist()
    latitude, longitude = reading.origin.globe(east, north)
    course = math.degrees(math.atan2(velocity[1], velocity[0])) % 360
    return mavlink.MAVLink_hil_gps_message(
        microseconds(tick),
        _FIX_3D,
        round(latitude * 1e7),
        round(longitude * 1e7),
        round((reading.origin.altitude - down) * 1e3),
        _EPH,
        _EPV,
        _bounded(math.hypot(velocity[0], velocity[1]), 0, 65_534),
        *(_bounded(component, -32_767, 32_767) for component in velocity),
        round(course * 100) % 36_000,
        _SATELLITES,
    )


def _bounded(speed: float, low: int, high: int) -> int:
    """Convert m/s to cm/s, limited to the range of the message's field."""
    return min(max(round(speed * 100), low), high)
