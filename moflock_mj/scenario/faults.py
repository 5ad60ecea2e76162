"""Faults of a scenario, tables `[[faults]]`: kind, affected drone or vehicle, start and duration.

Flights and simulated vehicles use the same names for the same faults. `moflock_mj.effects.fault_injection` describes
their effects in a flight. Order parameters keep the paper's definition over all drones, including those that crashed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

from moflock_mj.errors import ScenarioError
from moflock_mj.fields import Section, quantity


@dataclasses.dataclass(frozen=True, kw_only=True)
class FaultKind:
    """Properties of a kind of fault.

    Attributes:
        text: description in events.
        figures: fields that this kind requires; other kinds do not accept them.
        of_all: True if it may affect all drones at once.
        ends: True if it may end.
        falls: True if it can bring down the affected drone.
    """

    text: str
    figures: tuple[str, ...] = ()
    of_all: bool = True
    ends: bool = True
    falls: bool = False


KINDS = {
    "rotor_failure": FaultKind(
        text="a rotor loses thrust", figures=("rotor", "effectiveness"), of_all=False, falls=True
    ),
    "gps_loss": FaultKind(text="no GPS"),
    "gps_jump": FaultKind(text="GPS off", figures=("jump",)),
    "cannot_receive": FaultKind(text="cannot receive"),
    "link_loss": FaultKind(text="loses packets", figures=("share",)),
    "cannot_transmit": FaultKind(text="cannot transmit", of_all=False),
    "power_off": FaultKind(text="power off", of_all=False, ends=False, falls=True),
}
"""Kinds of faults in a flight, by name, in the order of their numbers in compiled code."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class FaultTable(Section):
    """Table `[[faults]]`. A subclass sets the permitted kinds and the field of the affected drone or vehicle.

    Raises:
        ScenarioError: a value is missing, of the wrong type or out of bounds, or does not apply to the kind.
    """

    table: ClassVar[str] = "faults"
    kinds: ClassVar[Mapping[str, FaultKind]] = {}
    subject: ClassVar[str] = "drone"
    """Field with the number of the affected drone or vehicle."""

    kind: str = quantity("", "1", "kind of fault")
    at: float = quantity(0.0, "s", "start of the fault", low=0, high=1e6)
    duration: float | None = quantity(
        None, "s", "duration; to the end of the flight if absent", low=0, open_low=True, high=1e6
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind not in self.kinds:
            raise ScenarioError(f"faults.kind: {self.kind!r} is unknown: it must be one of {', '.join(self.kinds)}")
        kind = self.kinds[self.kind]
        figures = dict.fromkeys(name for other in self.kinds.values() for name in other.figures)
        for name in figures:
            given, required = getattr(self, name) is not None, name in kind.figures
            if required and not given:
                raise ScenarioError(f"faults.{name}: is missing: {self.kind} needs it")
            if given and not required:
                raise ScenarioError(
                    f"faults.{name}: {getattr(self, name)!r} does not apply to {self.kind}: it must be absent"
                )
        if self.affected is None and not kind.of_all:
            raise ScenarioError(f"faults.{self.subject}: is missing: {self.kind} affects one {self.subject}")
        if self.duration is not None and not kind.ends:
            raise ScenarioError(
                f"faults.duration: {self.duration:g} s does not apply to {self.kind}: it must be absent"
            )

    @property
    def affected(self) -> int | None:
        """Number of the affected drone or vehicle; None for all."""
        number: int | None = getattr(self, self.subject)
        return number

    def check_against(self, count: int, duration: float, name: str) -> None:
        """Check drone and start against the flight.

        Args:
            count: number of drones or vehicles.
            duration: duration of the flight, s.
            name: prefix of the field in the message.

        Raises:
            ScenarioError: the drone or the start is out of bounds.
        """
        if self.affected is not None and self.affected >= count:
            raise ScenarioError(
                f"{name}.{self.subject}: {self.affected} is out of bounds: it must be at most {count - 1}"
            )
        if self.at >= duration:
            raise ScenarioError(f"{name}.at: {self.at:g} s must be under the duration, {duration:g} s")

    def describe(self) -> str:
        """Describe the fault in a few words, such as `drone 3: no GPS`."""
        affected_name = f"all {self.subject}s" if self.affected is None else f"{self.subject} {self.affected}"
        return f"{affected_name}: {self.kinds[self.kind].text}{self._figures_text()}"

    def _figures_text(self) -> str:
        return ""


@dataclasses.dataclass(frozen=True, kw_only=True)
class FaultConfig(FaultTable):
    """Fault in a flight.

    Example:
        >>> FaultConfig(kind="gps_loss", at=20.0, duration=10.0, drone=3).describe()
        'drone 3: no GPS'

    Raises:
        ScenarioError: see `FaultTable`.
    """

    kinds: ClassVar[Mapping[str, FaultKind]] = KINDS

    kind: str = quantity("", "1", "kind of fault", choices=tuple(KINDS))
    drone: int | None = quantity(
        None, "1", "number of the affected drone, from 0; all drones if absent", low=0, high=9999
    )
    rotor: int | None = quantity(None, "1", "number of the failed rotor of a rotor_failure, from 0", low=0, high=3)
    effectiveness: float | None = quantity(None, "1", "fraction of its thrust that the rotor keeps", low=0, high=1)
    jump: tuple[float, float] | None = quantity(
        None, "m", "offset of the GPS position by a gps_jump, x and y", low=-1e5, high=1e5
    )
    share: float | None = quantity(
        None,
        "1",
        "fraction of packets to and from a drone that a link_loss drops, in addition to other losses",
        low=0,
        high=1,
    )

    def _figures_text(self) -> str:
        figures: dict[str, Any] = {
            "rotor_failure": f" (rotor {self.rotor}, {self.effectiveness or 0:.0%} left)",
            "gps_jump": f" by ({', '.join(f'{metres:g}' for metres in self.jump or ())}) m",
            "link_loss": f" ({self.share or 0:.0%})",
        }
        return str(figures.get(self.kind, ""))
