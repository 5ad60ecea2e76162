"""Parameters of a vehicle: types and values, and their encoding in PARAM messages."""

from __future__ import annotations

import dataclasses
import struct

from moflock_mj.mavlink.dialect import mavlink

INT8, INT16, INT32, REAL32 = (
    mavlink.MAV_PARAM_TYPE_INT8,
    mavlink.MAV_PARAM_TYPE_INT16,
    mavlink.MAV_PARAM_TYPE_INT32,
    mavlink.MAV_PARAM_TYPE_REAL32,
)


_LIMITS = {INT8: 2**7, INT16: 2**15, INT32: 2**31}


@dataclasses.dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter.

    Attributes:
        kind: MAV_PARAM_TYPE.
        value: value, an integer for the integer kinds.
    """

    kind: int
    value: float


def carried_value(carried: float, kind: int, *, bytewise: bool) -> float:
    """Decode the float field of a PARAM message.

    Args:
        carried: value of the field.
        kind: MAV_PARAM_TYPE.
        bytewise: whether integers are encoded as the bytes of the float.
    """
    if bytewise and kind != REAL32:
        return float(struct.unpack("<i", struct.pack("<f", carried))[0])
    return carried


def value_carried(value: float, kind: int, *, bytewise: bool) -> float:
    """Encode a value as the float field of a PARAM message; see `carried_value`."""
    if bytewise and kind != REAL32:
        return float(struct.unpack("<f", struct.pack("<i", int(value)))[0])
    return value
