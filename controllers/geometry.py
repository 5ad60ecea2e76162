"""Rotations and vectors, for controllers and dynamics."""

from __future__ import annotations

import math

from controllers.compiling import hot_kernel


@hot_kernel
def body_axes(
    qw: float, qx: float, qy: float, qz: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Rotation matrix from body to world of a unit quaternion, row by row. Its columns are the body axes."""
    xx, yy, zz = 2.0 * qx * qx, 2.0 * qy * qy, 2.0 * qz * qz
    xy, xz, yz = 2.0 * qx * qy, 2.0 * qx * qz, 2.0 * qy * qz
    wx, wy, wz = 2.0 * qw * qx, 2.0 * qw * qy, 2.0 * qw * qz
    return 1.0 - yy - zz, xy - wz, xz + wy, xy + wz, 1.0 - xx - zz, yz - wx, xz - wy, yz + wx, 1.0 - xx - yy


@hot_kernel
def clip_length(x: float, y: float, longest: float) -> tuple[float, float]:
    """Limit the length of the vector (x, y) to `longest`."""
    squared = x * x + y * y
    if squared <= longest * longest:
        return x, y
    scale = longest / math.sqrt(squared)
    return x * scale, y * scale
