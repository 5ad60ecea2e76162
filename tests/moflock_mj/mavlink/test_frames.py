"""Frames and the globe, by cases with a known answer."""

from __future__ import annotations

import math

import pytest

from moflock_mj.mavlink.frames import (
    Origin,
    euler_of_quaternion,
    frd_of_flu,
    ned_of_world,
    quaternion_of_euler,
    world_of_ned,
)

HALF = math.sqrt(0.5)


def test_axes():
    assert ned_of_world((1, 2, 3)) == (2, 1, -3)
    assert world_of_ned(ned_of_world((1.5, -2.5, 3.5))) == (1.5, -2.5, 3.5)
    assert frd_of_flu((1, 2, 3)) == (1, -2, -3)


@pytest.mark.parametrize(
    ("quaternion", "angles"),
    [
        ((1, 0, 0, 0), (0, 0, 90)),  # our bodies face east
        ((HALF, 0, 0, HALF), (0, 0, 0)),  # a quarter turn to the left: north
        ((0, 0, 0, 1), (0, 0, -90)),  # west
        ((math.cos(0.1), math.sin(0.1), 0, 0), (math.degrees(0.2), 0, 90)),  # the left side up is the right side down
        ((math.cos(0.1), 0, math.sin(0.1), 0), (0, -math.degrees(0.2), 90)),  # about the left: nose down
    ],
)
def test_attitude(quaternion, angles):
    assert [math.degrees(angle) for angle in euler_of_quaternion(*quaternion)] == pytest.approx(angles, abs=1e-9)


@pytest.mark.parametrize("angles", [(0.3, -0.4, 2.0), (-1.0, 1.2, -3.0), (0, 0, 0)])
def test_a_quaternion_holds_its_angles(angles):
    """The aerospace rotation matrix, column by column, against the quaternion's."""
    roll, pitch, yaw = angles
    w, x, y, z = quaternion_of_euler(roll, pitch, yaw)
    assert w * w + x * x + y * y + z * z == pytest.approx(1)
    assert 1 - 2 * (y * y + z * z) == pytest.approx(math.cos(pitch) * math.cos(yaw))
    assert 2 * (x * y + w * z) == pytest.approx(math.cos(pitch) * math.sin(yaw))
    assert 2 * (x * z - w * y) == pytest.approx(-math.sin(pitch))
    assert 2 * (y * z + w * x) == pytest.approx(math.cos(pitch) * math.sin(roll))


def test_a_degree_on_the_ellipsoid():
    """Lengths of a degree of WGS 84 at 0, 45 and 60 degrees (NGA tables): of latitude, then of longitude."""
    for latitude, north, east in ((0, 110_574, 111_320), (45, 111_132, 78_847), (60, 111_412, 55_800)):
        x, y = Origin(latitude=latitude, longitude=10.0).world(latitude + 1e-3, 10.001)
        assert (x * 1e3, y * 1e3) == pytest.approx((east, north), rel=2e-5)


def test_there_and_back_again_across_the_date_line():
    origin = Origin(latitude=-17.0, longitude=179.9999)
    latitude, longitude = origin.globe(100.0, -250.0)
    assert origin.world(latitude, longitude) == pytest.approx((100.0, -250.0), abs=1e-6)
    assert origin.world(latitude, longitude - 360) == pytest.approx((100.0, -250.0), abs=1e-6)
