"""Frames: the world (ENU; bodies FLU), MAVLink's frames (NED; bodies FRD), and geographic coordinates."""

from __future__ import annotations

import dataclasses
import math

_SEMI_MAJOR_AXIS = 6_378_137.0
"""Semi-major axis of the WGS 84 ellipsoid, m (NIMA TR8350.2)."""
_FLATTENING = 1 / 298.257223563
"""Flattening of the WGS 84 ellipsoid (NIMA TR8350.2)."""
_ECCENTRICITY_SQ = _FLATTENING * (2 - _FLATTENING)

Triple = tuple[float, float, float]


def ned_of_world(vector: Triple) -> Triple:
    """Convert a vector from east, north, up to north, east, down, or back."""
    x, y, z = vector
    return y, x, -z


world_of_ned = ned_of_world
"""Conversion from north, east, down to east, north, up, which is the same exchange."""


def frd_of_flu(vector: Triple) -> Triple:
    """Convert a body-frame vector from forward, left, up to forward, right, down, or back."""
    x, y, z = vector
    return x, -y, -z


def euler_of_quaternion(qw: float, qx: float, qy: float, qz: float) -> Triple:
    """Roll, pitch and yaw from NED to FRD, rad, of a quaternion from the body (FLU) to the world (ENU).

    The aerospace sequence: yaw about down, clockwise from north, from -pi to pi; then pitch, then roll.
    """
    roll = math.atan2(2 * (qw * qx + qy * qz), 1 - 2 * (qx * qx + qy * qy))
    # In FLU and ENU, pitch and yaw have the opposite sign, and yaw starts at east.
    pitch = -math.asin(min(max(2 * (qw * qy - qz * qx), -1.0), 1.0))
    yaw = math.pi / 2 - math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
    return roll, pitch, math.remainder(yaw, 2 * math.pi)


def quaternion_of_euler(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Quaternion (w, x, y, z) of the aerospace angles, rad."""
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
    """Geographic position of the origin of the world frame, whose plane is tangent to the ellipsoid there.

    Attributes:
        latitude: latitude, degrees north.
        longitude: longitude, degrees east.
        altitude: altitude above mean sea level, m.
    """

    latitude: float = 47.397742
    longitude: float = 8.545594
    altitude: float = 488.0

    def globe(self, east: float, north: float) -> tuple[float, float]:
        """Latitude and longitude, degrees, of a place in the world frame, m."""
        per_north, per_east = self._metres_per_degree()
        return self.latitude + north / per_north, self.longitude + east / per_east

    def world(self, latitude: float, longitude: float) -> tuple[float, float]:
        """East and north, m, of a geographic position, degrees."""
        per_north, per_east = self._metres_per_degree()
        turn = math.remainder(longitude - self.longitude, 360.0)
        return turn * per_east, (latitude - self.latitude) * per_north

    def _metres_per_degree(self) -> tuple[float, float]:
        """Metres per degree of latitude and of longitude, from the ellipsoid's radii of curvature at the origin."""
        sine = math.sin(math.radians(self.latitude))
        cosine = math.cos(math.radians(self.latitude))
        squeeze = 1 - _ECCENTRICITY_SQ * sine * sine
        meridian = _SEMI_MAJOR_AXIS * (1 - _ECCENTRICITY_SQ) / squeeze**1.5
        parallel = _SEMI_MAJOR_AXIS / math.sqrt(squeeze) * cosine
        return math.radians(meridian), math.radians(parallel)
