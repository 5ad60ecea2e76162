"""A vehicle's parameters: names, types and values, and how a PARAM message carries them."""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Mapping

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
        value: whole for the integer kinds.
    """

    kind: int
    value: float


def carried_value(carried: float, kind: int, *, bytewise: bool) -> float:
    """The value that a PARAM message's float field carries.

    Args:
        carried: the field.
        kind: MAV_PARAM_TYPE.
        bytewise: whether integers travel as the bytes of the float.
    """
    if bytewise and kind != REAL32:
        return float(struct.unpack("<i", struct.pack("<f", carried))[0])
    return carried


def value_carried(value: float, kind: int, *, bytewise: bool) -> float:
    """The float field of a PARAM message for a value; arguments as those of `carried_value`."""
    if bytewise and kind != REAL32:
        return float(struct.unpack("<f", struct.pack("<i", int(value)))[0])
    return value


class ParameterTable:
    """Parameters in the order of their index.

    Args:
        defaults: by name, of at most 16 characters.
        bytewise: integers travel as the bytes of the float (PX4), else as its value (ArduPilot: a C cast).
    """

    def __init__(self, defaults: Mapping[str, Parameter], *, bytewise: bool) -> None:
        self._table = dict(defaults)
        self._names = list(self._table)
        self._indices = {name: index for index, name in enumerate(self._names)}
        self._bytewise = bytewise

    def __getitem__(self, name: str) -> float:
        return self._table[name].value

    def __contains__(self, name: str) -> bool:
        return name in self._table

    def __len__(self) -> int:
        return len(self._names)

    def name(self, index: int) -> str | None:
        """The name at an index, or None."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def set_value(self, name: str, value: float) -> None:
        """Set a known parameter; a value that its type cannot hold goes to the nearest that it can."""
        kind = self._table[name].kind
        if kind != REAL32:
            limit = _LIMITS[kind]
            value = float(min(max(round(value), -limit), limit - 1))
        self._table[name] = Parameter(kind, value)

    def receive(self, name: str, carried: float, kind: int) -> bool:
        """Take a PARAM_SET; returns whether it was one of a known parameter and a finite value.

        Args:
            name: of the parameter.
            carried: the message's float field.
            kind: the message's MAV_PARAM_TYPE. PX4 insists on its own, ArduPilot does not look.
        """
        known = self._table.get(name)
        if known is None:
            return False
        if self._bytewise and kind != known.kind:
            return False
        value = carried_value(carried, known.kind, bytewise=self._bytewise)
        if not math.isfinite(value):
            return False
        self.set_value(name, value)
        return True

    def message(self, name: str) -> mavlink.MAVLink_param_value_message:
        """The PARAM_VALUE of a parameter."""
        parameter = self._table[name]
        carried = value_carried(parameter.value, parameter.kind, bytewise=self._bytewise)
        return mavlink.MAVLink_param_value_message(
            name.encode(), carried, parameter.kind, len(self._names), self._indices[name]
        )
