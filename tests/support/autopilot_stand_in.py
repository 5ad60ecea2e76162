"""Stand-in for an autopilot in plain Python, for both simulator interfaces; it hovers an x500.

`python autopilot_stand_in.py KIND PORT HEIGHT` runs it as a program. It implements the documentation of each interface
and shares no code with the simulator's side except pymavlink.
"""

from __future__ import annotations

import json
import math
import socket
import struct
import sys
import time

import pymavlink.dialects.v20.ardupilotmega as mavlink

G = 9.81
HOVER = 2.0 * G / 4 / 8.829
"""Share of a rotor's maximum thrust at which the x500 hovers."""


def outputs_for(position, velocity, attitude, gyro, target):
    """Thrust shares of motors 1 to 4 of a quad X that move it from a NED position to `target`, heading east."""
    w, x, y, z = attitude
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    north, east, down = (
        max(-2.0, min(2.0, 1.0 * (t - p) - 1.6 * v)) for t, p, v in zip(target, position, velocity, strict=True)
    )
    forward = math.cos(yaw) * north + math.sin(yaw) * east
    right = -math.sin(yaw) * north + math.cos(yaw) * east
    roll_share = 0.125 * (right / G - roll) - 0.033 * gyro[0]
    pitch_share = 0.125 * (-forward / G - pitch) - 0.033 * gyro[1]
    yaw_share = 0.16 * math.remainder(math.pi / 2 - yaw, 2 * math.pi) - 0.17 * gyro[2]
    lift = HOVER * (1 - down / G)
    return [
        max(0.0, min(1.0, share))
        for share in (
            lift - roll_share + pitch_share + yaw_share,
            lift + roll_share - pitch_share + yaw_share,
            lift + roll_share + pitch_share - yaw_share,
            lift - roll_share - pitch_share - yaw_share,
        )
    ]


class ArduPilotStandIn:
    """Autopilot side of ArduPilot's JSON interface. Each exchange is `send`, then `receive`."""

    magic, layout = 18458, struct.Struct("<HHI16H")

    def __init__(self, port, height):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.settimeout(5.0)
        self.height, self.frame, self.pwm, self.place, self.state = height, 0, [1000] * 4, None, None

    def send(self):
        self.socket.send(self.layout.pack(self.magic, 1200, self.frame, *self.pwm, *[0] * 12))

    def receive(self):
        line = self.socket.recv(4096)
        assert line[:1] == line[-1:] == b"\n"
        self.state = state = json.loads(line)
        self.frame += 1
        position = state["position"]
        self.place = self.place or position
        target = (self.place[0], self.place[1], -self.height)
        shares = outputs_for(position, state["velocity"], state["quaternion"], state["imu"]["gyro"], target)
        # Inverse of the thrust curve with MOT_THST_EXPO 0.65.
        e = 0.65
        self.pwm = [round(1000 + 500 * (math.sqrt((1 - e) ** 2 + 4 * e * share) - (1 - e)) / e) for share in shares]


class Px4StandIn:
    """Autopilot side of PX4's simulator interface. Each exchange is `send`, then `receive`.

    The attitude is the integral of the gyroscope. Position and velocity are those of the GPS, extrapolated with the
    accelerometer.
    """

    def __init__(self, port, height):
        self.socket = socket.create_connection(("127.0.0.1", port))
        self.socket.settimeout(5.0)
        self.packer, self.decoder = mavlink.MAVLink(None, srcSystem=1), mavlink.MAVLink(None)
        self.height, self.time, self.place, self.shares = height, None, None, [0.0] * 4
        self.attitude = [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
        self.position, self.velocity = None, [0.0] * 3

    def send(self):
        if self.time is not None:
            controls = [*self.shares, *[0.0] * 12]
            answer = mavlink.MAVLink_hil_actuator_controls_message(self.time, controls, 129, 1)
            self.socket.sendall(answer.pack(self.packer))

    def receive(self):
        messages = []
        while not any(message.get_type() == "HIL_SENSOR" for message in messages):
            chunk = self.socket.recv(4096)
            if not chunk:
                raise ConnectionError
            messages += self.decoder.parse_buffer(chunk) or []
        for message in messages:
            if message.get_type() == "HIL_SENSOR":
                self._read_imu(message)
            else:
                self._fix(message)
        if self.position is not None:
            self.place = self.place or self.position
            target = (self.place[0], self.place[1], -self.height)
            self.shares = outputs_for(self.position, self.velocity, self.attitude, self.gyro, target)

    def _fix(self, gps):
        north = math.radians(gps.lat / 1e7 - 47.397742) * 6_371_000
        east = math.radians(gps.lon / 1e7 - 8.545594) * 6_371_000 * math.cos(math.radians(47.397742))
        self.position = [north, east, 488.0 - gps.alt / 1e3]
        self.velocity = [gps.vn / 100, gps.ve / 100, gps.vd / 100]

    def _read_imu(self, imu):
        dt = 0.0 if self.time is None else (imu.time_usec - self.time) / 1e6
        self.time, self.imu = imu.time_usec, imu
        w, x, y, z = self.attitude
        self.gyro = p, q, r = imu.xgyro, imu.ygyro, imu.zgyro
        rate = (-x * p - y * q - z * r, w * p + y * r - z * q, w * q - x * r + z * p, w * r + x * q - y * p)
        turned = [a + dt / 2 * b for a, b in zip(self.attitude, rate, strict=True)]
        norm = math.sqrt(sum(a * a for a in turned))
        self.attitude = w, x, y, z = [a / norm for a in turned]
        if self.position is not None:
            a, b, c = imu.xacc, imu.yacc, imu.zacc
            push = (
                (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c,
                2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c,
                2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c + G,
            )
            self.velocity = [v + dt * a for v, a in zip(self.velocity, push, strict=True)]
            self.position = [p + dt * v for p, v in zip(self.position, self.velocity, strict=True)]


FLYING = 100
"""Number of exchanges after which a stand-in reports that it flies."""

STAND_INS = {"ardupilot": ArduPilotStandIn, "px4": Px4StandIn}


def main(kind, port, height, *_):
    """Fly until killed; retry until the simulator is available."""
    print("stand-in of", kind, "at", port, flush=True)
    autopilot, exchanges = None, 0
    while True:
        try:
            autopilot = autopilot or STAND_INS[kind](int(port), float(height))
            autopilot.send()
            autopilot.receive()
            exchanges += 1
            if exchanges == FLYING:
                print("flying", flush=True)
        except OSError:
            time.sleep(0.01)


if __name__ == "__main__":
    main(*sys.argv[1:])
