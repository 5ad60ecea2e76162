"""Frames: our world (x east, y north, z up; bodies x forward, y left, z up), MAVLink's (NED; bodies FRD), the globe."""

from __future__ import annotations

import dataclasses
import math

_SEMI_MAJOR_AXIS = 6_378_137.0
"""m, of the WGS 84 ellipsoid (NIMA TR8350.2)."""
_FLATTENING = 1 / 298.257223563
"""Of the WGS 84 ellipsoid."""
_ECCENTRICITY_SQ = _FLATTENING * (2 - _FLATTENING)

Triple = tuple[float, float, float]


def ned_of_world(vector: Triple) -> Triple:
    """North, east, down of a vector whose components are east, north, up; and the other way round."""
    x, y, z = vector
    return y, x, -z


world_of_ned = ned_of_world
"""East, north, up of north, east, down: the same exchange."""


def frd_of_flu(vector: Triple) -> Triple:
    """Forward, right, down of a body's vector forward, left, up; and the other way round."""
    x, y, z = vector
    return x, -y, -z


def euler_of_quaternion(qw: float, qx: float, qy: float, qz: float) -> Triple:
    """Roll, pitch, yaw (rad) from NED to FRD of a quaternion from our body to our world.

    The aerospace sequence: yaw about down, clockwise from north, in -pi to pi; then pitch, then roll.
    """
    roll = math.atan2(2 * (qw * qx + qy * qz), 1 - 2 * (qx * qx + qy * qy))
    # In our frames pitch and yaw turn the other way; yaw counts from east.
    pitch = -math.asin(min(max(2 * (qw * qy - qz * qx), -1.0), 1.0))
    yaw = math.pi / 2 - math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
    return roll, pitch, math.remainder(yaw, 2 * math.pi)


def quaternion_of_euler(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Quaternion w x y z of the aerospace angles."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Origin:
    """The place on the globe of our world's origin; the world's plane touches the ellipsoid there.

    Attributes:
        latitude: degrees, north.
        longitude: degrees, east.
        altitude: m, above mean sea level.
    """

    latitude: float = 47.397742
    longitude: float = 8.545594
    altitude: float = 488.0

    def globe(self, east: float, north: float) -> tuple[float, float]:
        """Latitude and longitude, degrees, of a place in our world, m."""
        per_north, per_east = self._metres_per_degree()
        return self.latitude + north / per_north, self.longitude + east / per_east

    def world(self, latitude: float, longitude: float) -> tuple[float, float]:
        """East and north, m, of a place on the globe, degrees."""
        per_north, per_east = self._metres_per_degree()
        turn = math.remainder(longitude - self.longitude, 360.0)
        return turn * per_east, (latitude - self.latitude) * per_north

    def _metres_per_degree(self) -> tuple[float, float]:
        """Of latitude and of longitude, by the ellipsoid's two radii of curvature at the origin."""
        sine = math.sin(math.radians(self.latitude))
        cosine = math.cos(math.radians(self.latitude))
        squeeze = 1 - _ECCENTRICITY_SQ * sine * sine
        meridian = _SEMI_MAJOR_AXIS * (1 - _ECCENTRICITY_SQ) / squeeze**1.5
        parallel = _SEMI_MAJOR_AXIS / math.sqrt(squeeze) * cosine
        return math.radians(meridian), math.radians(parallel)
