"""Faults: what fails, in which drone or vehicle, when and for how long; tables `[[faults]]`.

Flights and simulated vehicles have the same words for the same faults. What each does in a flight is in
`moflock_mj.effects.fault_injection`. Order parameters stay what the paper defines: over all drones, those that a fault
has brought down included.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

from moflock_mj.errors import ScenarioError
from moflock_mj.fields import Section, quantity


@dataclasses.dataclass(frozen=True, kw_only=True)
class FaultKind:
    """What a kind of fault needs and allows.

    Attributes:
        text: what its events say.
        figures: fields that it must have, and no other kind.
        of_all: whether it may affect all drones at once.
        ends: whether it may end.
        falls: whether the drone that it affects may come down by it.
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
"""Kinds in a flight, by name; the order is that of the compiled code's numbers."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class FaultTable(Section):
    """A table `[[faults]]`; subclasses say which kinds there are, and whom they affect.

    Raises:
        ScenarioError: a value is of the wrong type or out of bounds, missing, or of another kind.
    """

    table: ClassVar[str] = "faults"
    kinds: ClassVar[Mapping[str, FaultKind]] = {}
    subject: ClassVar[str] = "drone"
    """Field that holds the number of the one that is affected."""

    kind: str = quantity("", "1", "what fails")
    at: float = quantity(0.0, "s", "when it begins", low=0, high=1e6)
    duration: float | None = quantity(
        None, "s", "how long; to the end of the flight if absent", low=0, open_low=True, high=1e6
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind not in self.kinds:
            raise ScenarioError(f"faults.kind: {self.kind!r} is unknown: it must be one of {', '.join(self.kinds)}")
        kind = self.kinds[self.kind]
        figures = dict.fromkeys(name for other in self.kinds.values() for name in other.figures)
        for name in figures:
            given, wanted = getattr(self, name) is not None, name in kind.figures
            if wanted and not given:
                raise ScenarioError(f"faults.{name}: is missing: {self.kind} needs it")
            if given and not wanted:
                raise ScenarioError(
                    f"faults.{name}: {getattr(self, name)!r} means nothing to {self.kind}: leave it out"
                )
        if self.affected is None and not kind.of_all:
            raise ScenarioError(f"faults.{self.subject}: is missing: {self.kind} affects one {self.subject}")
        if self.duration is not None and not kind.ends:
            raise ScenarioError(
                f"faults.duration: {self.duration:g} s means nothing to {self.kind}, which does not end"
            )

    @property
    def affected(self) -> int | None:
        """Number of the one that is affected; None for all."""
        number: int | None = getattr(self, self.subject)
        return number

    def check_against(self, count: int, duration: float, name: str) -> None:
        """Refuse a drone or a time that the flight does not have; `name` stands before the field in the error.

        Raises:
            ScenarioError: one line.
        """
        if self.affected is not None and self.affected >= count:
            raise ScenarioError(
                f"{name}.{self.subject}: {self.affected} is out of bounds: it must be at most {count - 1}"
            )
        if self.at >= duration:
            raise ScenarioError(f"{name}.at: {self.at:g} s must be under the duration, {duration:g} s")

    def describe(self) -> str:
        """The fault in a few words, such as `drone 3: no GPS`."""
        who = f"all {self.subject}s" if self.affected is None else f"{self.subject} {self.affected}"
        return f"{who}: {self.kinds[self.kind].text}{self._figures_text()}"

    def _figures_text(self) -> str:
        return ""


@dataclasses.dataclass(frozen=True, kw_only=True)
class FaultConfig(FaultTable):
    """One fault of a flight.

    Example:
        >>> FaultConfig(kind="gps_loss", at=20.0, duration=10.0, drone=3).describe()
        'drone 3: no GPS'

    Raises:
        ScenarioError: see `FaultTable`.
    """

    kinds: ClassVar[Mapping[str, FaultKind]] = KINDS

    kind: str = quantity("", "1", "what fails", choices=tuple(KINDS))
    drone: int | None = quantity(None, "1", "the drone's number, from 0; all drones if absent", low=0, high=9999)
    rotor: int | None = quantity(None, "1", "number of the rotor of a rotor_failure, from 0", low=0, high=3)
    effectiveness: float | None = quantity(None, "1", "share of its thrust that the rotor keeps", low=0, high=1)
    jump: tuple[float, float] | None = quantity(
        None, "m", "x and y that a gps_jump adds to the position", low=-1e5, high=1e5
    )
    share: float | None = quantity(
        None, "1", "share of packets to and from a drone that a link_loss takes, on top of others", low=0, high=1
    )

    def _figures_text(self) -> str:
        figures: dict[str, Any] = {
            "rotor_failure": f" (rotor {self.rotor}, {self.effectiveness or 0:.0%} left)",
            "gps_jump": f" by ({', '.join(f'{metres:g}' for metres in self.jump or ())}) m",
            "link_loss": f" ({self.share or 0:.0%})",
        }
        return str(figures.get(self.kind, ""))
