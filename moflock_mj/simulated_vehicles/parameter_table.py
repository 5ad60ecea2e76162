"""The parameters of a simulated vehicle, by name."""

from __future__ import annotations

import math
from collections.abc import Mapping

from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.mavlink.parameters import _LIMITS, REAL32, Parameter, carried_value, value_carried


class ParameterTable:
    """Parameters in the order of their index.

    Args:
        defaults: defaults by name, of at most 16 characters.
        bytewise: whether integers are encoded as the bytes of the float (PX4) or as its value (ArduPilot's C cast).
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
        """Set a known parameter; a value is limited to the range of the parameter's type."""
        kind = self._table[name].kind
        if kind != REAL32:
            limit = _LIMITS[kind]
            value = float(min(max(round(value), -limit), limit - 1))
        self._table[name] = Parameter(kind, value)

    def receive(self, name: str, carried: float, kind: int) -> bool:
        """Process a PARAM_SET; returns whether the parameter is known and the value finite.

        Args:
            name: name of the parameter.
            carried: float field of the message.
            kind: MAV_PARAM_TYPE of the message; PX4 requires the parameter's own type, ArduPilot ignores it.
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
        """PARAM_VALUE message of a parameter."""
        parameter = self._table[name]
        carried = value_carried(parameter.value, parameter.kind, bytewise=self._bytewise)
        return mavlink.MAVLink_param_value_message(
            name.encode(), carried, parameter.kind, len(self._names), self._indices[name]
        )
