"""The bytes of both interfaces: recorded, built from the documents, and hostile."""

from __future__ import annotations

import json
import struct

import numpy as np
import pymavlink.dialects.v20.ardupilotmega as mavlink
import pytest

from moflock_mj.mavlink.frames import Origin
from moflock_mj.sitl.ardupilot_json import Pulses, parse_pulses, sensor_line
from moflock_mj.sitl.interface import Reading
from moflock_mj.sitl.px4_hil import Px4Link, gps_message, sensor_message
from moflock_mj.sitl.sensors import Motion, Surroundings

MOTION = Motion(
    gyro=np.array([[0.1, -0.2, 0.3]]),
    specific_force=np.array([[0.5, -0.25, -9.81]]),
    attitude=np.array([[0.8, 0.0, 0.0, 0.6]]),
    position=np.array([[111.0, -7.5, -20.0]]),
    velocity=np.array([[3.0, -4.0, 0.5]]),
)
SURROUNDINGS = Surroundings(
    magnetic_field=np.array([[0.2, 0.01, 0.43]]),
    pressure=np.array([95_000.0]),
    temperature=np.array([11.5]),
    pressure_altitude=np.array([540.0]),
)
READING = Reading(12.5, MOTION, lambda: SURROUNDINGS, Origin())

SIXTEEN = struct.pack("<HHI16H", 18458, 1200, 77, 1100, 1200, 1300, 1400, *[0] * 12)
THIRTY_TWO = struct.pack("<HHI32H", 29569, 400, 2**32 - 1, 1000, 2000, 0, 2200, *[65535] * 28)


def test_pulses_of_both_layouts():
    assert parse_pulses(SIXTEEN) == Pulses(1200, 77, (1100, 1200, 1300, 1400))
    assert parse_pulses(THIRTY_TWO) == Pulses(400, 2**32 - 1, (1000, 2000, 0, 2200))


@pytest.mark.parametrize(
    "packet",
    [
        b"",
        b"H",
        SIXTEEN[:-1],
        SIXTEEN + b"\0",
        THIRTY_TWO[:40],
        b"\0\0" + SIXTEEN[2:],
        struct.pack("<HHI16H", 18458, 1200, 77, 2201, *[0] * 15),
        struct.pack(">HHI16H", 18458, 1200, 77, *[1000] * 16),
    ],
)
def test_what_is_no_pulses(packet):
    assert parse_pulses(packet) is None


def test_a_line_as_ardupilot_reads_it():
    """It looks for keys by their names, and reads numbers right behind `[` and between commas."""
    line = sensor_line(2.5, READING, 0)
    assert line.startswith(b"\n{")
    assert line.endswith(b"}\n")
    assert b" " not in line
    assert json.loads(line) == {
        "timestamp": 10.0,
        "imu": {"gyro": [0.1, -0.2, 0.3], "accel_body": [0.5, -0.25, -9.81]},
        "position": [111.0, -7.5, -20.0],
        "quaternion": [0.8, 0.0, 0.0, 0.6],
        "velocity": [3.0, -4.0, 0.5],
    }


def sent(message):
    """A message as the other side decodes it."""
    decoder = mavlink.MAVLink(None)
    return decoder.decode(bytearray(message.pack(mavlink.MAVLink(None, srcSystem=1))))


def test_hil_sensor_with_and_without_surroundings():
    bare = sent(sensor_message(3, READING, 0, None))
    assert bare.time_usec == 12_000
    assert bare.fields_updated == 0b111111
    np.testing.assert_allclose([bare.xacc, bare.yacc, bare.zacc], [0.5, -0.25, -9.81], rtol=1e-6)
    np.testing.assert_allclose([bare.xgyro, bare.ygyro, bare.zgyro], [0.1, -0.2, 0.3], rtol=1e-6)
    full = sent(sensor_message(3, READING, 0, SURROUNDINGS))
    assert full.fields_updated == 0b1101111111111
    np.testing.assert_allclose([full.xmag, full.ymag, full.zmag], [0.2, 0.01, 0.43], rtol=1e-6)
    assert (full.abs_pressure, full.pressure_alt, full.temperature) == (950.0, 540.0, 11.5)


def test_hil_gps():
    gps = sent(gps_message(250, READING, 0))
    assert (gps.time_usec, gps.fix_type) == (1_000_000, 3)
    assert gps.lat / 1e7 - 47.397742 == pytest.approx(111.0 / 111_180, rel=1e-3)
    assert gps.lon / 1e7 < 8.545594
    assert gps.alt == 508_000
    assert (gps.vel, gps.vn, gps.ve, gps.vd) == (500, 300, -400, 50)
    assert gps.cog == pytest.approx(30_687, abs=1)


def test_a_body_that_has_been_hurled_away_can_still_be_sent():
    far = READING._replace(motion=MOTION._replace(velocity=np.array([[1e4, -1e4, 1e4]])))
    gps = sent(gps_message(1, far, 0))
    assert (gps.vn, gps.ve, gps.vd) == (32_767, -32_767, 32_767)


def test_mutated_pulses_are_dropped_or_within_bounds():
    rng = np.random.default_rng(1)
    taken = 0
    for _ in range(5000):
        packet = bytearray(SIXTEEN if rng.random() < 0.5 else THIRTY_TWO)
        for _ in range(int(rng.integers(1, 4))):
            packet[int(rng.integers(len(packet)))] = int(rng.integers(256))
        pulses = parse_pulses(bytes(packet))
        if pulses is not None:
            taken += 1
            assert all(0 <= pwm <= 2200 for pwm in pulses.pwm)
    assert 0 < taken < 5000


@pytest.mark.parametrize("control", [float("nan"), float("inf"), -5.0, 7.0])
def test_controls_out_of_bounds_never_reach_a_motor(control):
    link = Px4Link(0)
    message = mavlink.MAVLink_hil_actuator_controls_message(0, [control, 0.5, *[0.0] * 14], 129, 1)
    link._take(message)
    expected = {-5.0: (0.0, 0.5, 0.0, 0.0), 7.0: (1.0, 0.5, 0.0, 0.0)}.get(control, (0.0, 0.0, 0.0, 0.0))
    assert link.outputs == expected
    assert link.counts.dropped == (not np.isfinite(control))
