"""Faults of simulated vehicles, with the same names as the faults of a flight."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from moflock_mj.errors import FleetError, ScenarioError
from moflock_mj.fields import quantity
from moflock_mj.scenario.faults import FaultKind, FaultTable

ALL = "all"
"""Text for all vehicles in place of a vehicle's number."""

VEHICLE_KINDS = {
    "gps_loss": FaultKind(text="no GPS"),
    "link_loss": FaultKind(text="loses packets", figures=("share",)),
    "link_delay": FaultKind(text="packets are late", figures=("delay",)),
    "cannot_receive": FaultKind(text="cannot receive"),
    "cannot_transmit": FaultKind(text="cannot transmit"),
    "rotor_failure": FaultKind(text="a rotor stands still", figures=("rotor",), falls=True),
    "low_battery": FaultKind(text="low battery", figures=("charge",)),
    "duplicate_id": FaultKind(text="another system id", figures=("system",)),
    "pilot": FaultKind(text="a pilot takes over by remote control"),
}
"""Kinds of faults of simulated vehicles, by name."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class VehicleFault(FaultTable):
    """One fault of a simulated vehicle.

    Raises:
        ScenarioError: see `FaultTable`.
    """

    kinds: ClassVar[Mapping[str, FaultKind]] = VEHICLE_KINDS
    subject: ClassVar[str] = "vehicle"

    kind: str = quantity("", "1", "what fails", choices=tuple(VEHICLE_KINDS))
    vehicle: int | None = quantity(None, "1", "the vehicle's number, from 0; all vehicles if absent", low=0, high=9999)
    share: float | None = quantity(None, "1", "share of packets each way that a link_loss takes", low=0, high=1)
    delay: float | None = quantity(None, "s", "time by which a link_delay holds up packets each way", low=0, high=60)
    rotor: int | None = quantity(None, "1", "number of the rotor of a rotor_failure, from 0", low=0, high=3)
    charge: float | None = quantity(None, "1", "share of charge to which a low_battery falls", low=0, high=1)
    system: int | None = quantity(None, "1", "system id that a duplicate_id takes", low=1, high=250)

    @classmethod
    def from_text(cls, text: str) -> VehicleFault:
        """Parse a fault from a text such as vehicle=3,at=20,kind=gps_loss,duration=10.

        Raises:
            FleetError: the text has another form, or a value is invalid.
        """
        given: dict[str, Any] = {}
        for part in text.split(","):
            key, equals, value = (piece.strip() for piece in part.partition("="))
            if not equals or key in given:
                raise FleetError(f"fault {text!r}: {part.strip()!r}: it must be key=value, with each key once")
            given[key] = value if key == "kind" else _parsed(value)
        if given.get("vehicle") == ALL:
            given["vehicle"] = None
        try:
            return cls.read(given)
        except ScenarioError as problem:
            raise FleetError(f"fault {text!r}: {str(problem).removeprefix('faults.')}") from None

    def acts(self, time: float) -> bool:
        """Whether the fault is active at a time, s."""
        return self.at <= time < self.at + (math.inf if self.duration is None else self.duration)


def load_faults(path: Path) -> tuple[VehicleFault, ...]:
    """Load faults from a TOML file with one table [[faults]] each.

    Raises:
        FleetError: the file cannot be read, or has other content.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise FleetError(f"faults {path}: {problem.strerror}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as problem:
        raise FleetError(f"faults {path}: not TOML: {problem}") from None
    faults = tables.pop("faults", [])
    if tables:
        raise FleetError(f"faults {path}: {next(iter(tables))}: it must contain only tables [[faults]]")
    try:
        return VehicleFault.read_all(faults)
    except ScenarioError as problem:
        raise FleetError(f"faults {path}: {problem}") from None


def check_faults(faults: Sequence[VehicleFault], vehicles: int) -> None:
    """Refuse faults of vehicles that do not exist.

    Raises:
        FleetError: a vehicle's number is too large.
    """
    for fault in faults:
        if fault.vehicle is not None and fault.vehicle >= vehicles:
            raise FleetError(
                f"fault {fault.kind}: vehicle {fault.vehicle} is out of bounds: it must be at most {vehicles - 1}"
            )


class Schedule:
    """Schedule of the faults of one vehicle; among simultaneous faults of one kind, the last one in the list applies.

    Args:
        faults: faults of the vehicle.
        begin: callback for each fault that begins.
        end: callback for each fault that ends.
    """

    def __init__(
        self, faults: Sequence[VehicleFault], begin: Callable[[VehicleFault], None], end: Callable[[VehicleFault], None]
    ) -> None:
        self._faults = faults
        self._begin = begin
        self._end = end
        self._acting: list[VehicleFault] = []

    def update(self, time: float) -> None:
        """Advance to `time`, s."""
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

    def acting(self, kind: str) -> VehicleFault | None:
        """The active fault of a kind, or None."""
        return next((fault for fault in reversed(self._acting) if fault.kind == kind), None)


def _parsed(text: str) -> float | int | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
