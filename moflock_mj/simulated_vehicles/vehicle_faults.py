"""Faults of simulated vehicles: what breaks, in which one, when and for how long."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from moflock_mj.errors import FleetError

ALL = -1
"""In place of a drone's number: all of them."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Kind:
    """What a fault's value means: its default, and its bounds."""

    default: float
    low: float
    high: float
    whole: bool = False


_NO_VALUE = _Kind(default=0.0, low=0.0, high=0.0)
KINDS: Mapping[str, _Kind] = {
    "silent": _NO_VALUE,
    "gps_loss": _NO_VALUE,
    "low_battery": _Kind(default=0.1, low=0.0, high=1.0),
    "link_loss": _Kind(default=0.3, low=0.0, high=1.0),
    "delay": _Kind(default=0.5, low=0.0, high=60.0),
    "duplicate_id": _Kind(default=1, low=1, high=250, whole=True),
    "motor_failure": _Kind(default=0, low=0, high=3, whole=True),
    "pilot": _NO_VALUE,
}
"""By name: silent: nothing is sent or received. gps_loss: no fix. low_battery: the charge falls to a share. link_loss:
a share of packets is lost each way. delay: s, of packets each way. duplicate_id: the vehicle calls itself by this
system id. motor_failure: the rotor of this number stands still. pilot: a remote control takes over, in LOITER or
POSITION.
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault.

    Attributes:
        drone: its number, from 0, or ALL.
        kind: of KINDS.
        at: s after the start.
        duration: s, `for` in texts; infinite if none is given.
        value: see KINDS.
    """

    drone: int
    kind: str
    at: float
    duration: float
    value: float

    @classmethod
    def of(cls, given: Mapping[str, Any], source: str) -> Fault:
        """A fault of the keys drone, kind, at, for, value.

        Raises:
            FleetError: a key is unknown or missing, or a value is out of bounds.
        """
        unknown = sorted(set(given) - {"drone", "kind", "at", "for", "value"})
        if unknown:
            raise FleetError(f"{source}: {unknown[0]} is unknown: it must be one of drone, kind, at, for, value")
        kind_name = given.get("kind")
        if not isinstance(kind_name, str) or kind_name not in KINDS:
            raise FleetError(f"{source}: kind {kind_name!r} is unknown: it must be one of {', '.join(KINDS)}")
        kind = KINDS[kind_name]
        if "drone" not in given:
            raise FleetError(f"{source}: drone is missing: it must be a number from 0, or all")
        drone = ALL if given["drone"] == "all" else int(_number(given, "drone", 0, 10_000, source, whole=True))
        return cls(
            drone=drone,
            kind=kind_name,
            at=_number(given, "at", 0, math.inf, source, default=0.0),
            duration=_number(given, "for", 0, math.inf, source, default=math.inf),
            value=_number(given, "value", kind.low, kind.high, source, default=kind.default, whole=kind.whole),
        )

    @classmethod
    def from_text(cls, text: str) -> Fault:
        """A fault of a text such as drone=3,at=20,kind=gps_loss,for=10.

        Raises:
            FleetError: it is no such text.
        """
        given: dict[str, Any] = {}
        for part in text.split(","):
            key, equals, value = (piece.strip() for piece in part.partition("="))
            if not equals or key in given:
                raise FleetError(f"fault {text!r}: {part.strip()!r} must be key=value, each key once")
            given[key] = value if key == "kind" or value == "all" else _parsed(value)
        return cls.of(given, f"fault {text!r}")

    def acts(self, time: float) -> bool:
        """Whether it acts at a time, s."""
        return self.at <= time < self.at + self.duration


def load_faults(path: Path) -> list[Fault]:
    """Faults of a TOML file: a table [[fault]] each.

    Raises:
        FleetError: the file cannot be read, or holds something else.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise FleetError(f"faults {path}: {problem.strerror}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as problem:
        raise FleetError(f"faults {path}: not TOML: {problem}") from None
    faults = tables.pop("fault", [])
    if tables or not isinstance(faults, list) or not all(isinstance(fault, dict) for fault in faults):
        raise FleetError(f"faults {path}: must hold nothing but tables [[fault]]")
    return [Fault.of(fault, f"faults {path}, number {number}") for number, fault in enumerate(faults, 1)]


def check_faults(faults: Sequence[Fault], drones: int) -> None:
    """Refuse faults of drones that there are not.

    Raises:
        FleetError: a number that is too large.
    """
    for fault in faults:
        if fault.drone >= drones:
            raise FleetError(f"fault {fault.kind}: drone {fault.drone} is out of bounds: it must be below {drones}")


class Schedule:
    """Faults of one vehicle as time goes on; of several of a kind at once, the last named counts.

    Args:
        faults: of this vehicle.
        begin: told each fault that begins.
        end: told each fault that ends.
    """

    def __init__(self, faults: Sequence[Fault], begin: Callable[[Fault], None], end: Callable[[Fault], None]) -> None:
        self._faults = faults
        self._begin = begin
        self._end = end
        self._acting: list[Fault] = []

    def update(self, time: float) -> None:
        """Go on to `time`, s."""
        if not self._faults:
            return
        acting = [fault for fault in self._faults if fault.acts(time)]
        ended = [fault for fault in self._acting if fault not in acting]
        begun = [fault for fault in acting if fault not in self._acting]
        self._acting = acting
        for fault in ended:
            self._end(fault)
        for fault in begun:
            self._begin(fault)

    def value(self, kind: str) -> float | None:
        """The value of an acting fault, None if there is none."""
        values = [fault.value for fault in self._acting if fault.kind == kind]
        return values[-1] if values else None


def _parsed(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _number(
    given: Mapping[str, Any],
    key: str,
    low: float,
    high: float,
    source: str,
    *,
    default: float = 0.0,
    whole: bool = False,
) -> float:
    value = given.get(key, default)
    fits = isinstance(value, (int, float)) and not isinstance(value, bool) and low <= value <= high
    if not fits or (whole and value != int(value)):
        limits = f"from {low:g} to {high:g}" if math.isfinite(high) else f"at least {low:g}"
        raise FleetError(f"{source}: {key} {value!r} is out of bounds: it must be {'whole, ' if whole else ''}{limits}")
    return float(value)
