"""Faults of a flight: what breaks, in which drone, when and for how long; the tables `[[faults]]` of a scenario.

What each does is in `moflock_mj.effects.fault_injection`. Order parameters stay what the paper defines: over
all drones, those that a fault has brought down included.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from moflock_mj.errors import ScenarioError
from moflock_mj.fields import Section, quantity


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Kind:
    """What a kind of fault needs and allows.

    Attributes:
        text: what its events say.
        figures: fields that it must have, and no other kind.
        of_all: whether it may befall all drones at once.
        ends: whether it may end.
        falls: whether the drone that it befalls may come down by it.
    """

    text: str
    figures: tuple[str, ...] = ()
    of_all: bool = True
    ends: bool = True
    falls: bool = False


KINDS = {
    "rotor_loss": _Kind(text="a rotor loses thrust", figures=("rotor", "effectiveness"), of_all=False, falls=True),
    "gps_outage": _Kind(text="no GPS"),
    "gps_jump": _Kind(text="GPS off", figures=("jump",)),
    "blackout": _Kind(text="hears nobody"),
    "packet_loss": _Kind(text="loses packets", figures=("share",)),
    "silent": _Kind(text="silent", of_all=False),
    "switched_off": _Kind(text="switched off", of_all=False, ends=False, falls=True),
}
"""By name; the order is that of the compiled code's numbers."""


_FIGURES = ("rotor", "effectiveness", "jump", "share")


@dataclasses.dataclass(frozen=True, kw_only=True)
class FaultConfig(Section):
    """One fault: a table `[[faults]]`.

    Raises:
        ScenarioError: a value is of the wrong type or out of bounds, missing, or of another kind.
    """

    table: ClassVar[str] = "faults"

    kind: str = quantity("", "1", "what breaks", choices=tuple(KINDS))
    at: float = quantity(0.0, "s", "when it begins", low=0, high=1e6)
    lasts: float | None = quantity(
        None, "s", "how long; to the end of the flight if absent", low=0, open_low=True, high=1e6
    )
    drone: int | None = quantity(None, "1", "the drone's number, from 0; all drones if absent", low=0, high=9999)
    rotor: int | None = quantity(None, "1", "number of a rotor_loss's rotor, from 0", low=0, high=3)
    effectiveness: float | None = quantity(None, "1", "share of its thrust that the rotor keeps", low=0, high=1)
    jump: tuple[float, float] | None = quantity(
        None, "m", "x and y that a gps_jump adds to the position", low=-1e5, high=1e5
    )
    share: float | None = quantity(
        None, "1", "share of packets to and from a drone that a packet_loss takes, on top of others", low=0, high=1
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        kind = KINDS[self.kind]
        for name in _FIGURES:
            given, wanted = getattr(self, name) is not None, name in kind.figures
            if wanted and not given:
                raise ScenarioError(f"faults.{name}: is missing: {self.kind} needs it")
            if given and not wanted:
                raise ScenarioError(
                    f"faults.{name}: {getattr(self, name)!r} means nothing to {self.kind}: leave it out"
                )
        if self.drone is None and not kind.of_all:
            raise ScenarioError(f"faults.drone: is missing: {self.kind} befalls one drone")
        if self.lasts is not None and not kind.ends:
            raise ScenarioError(f"faults.lasts: {self.lasts:g} s means nothing to {self.kind}, which does not end")

    def check_against(self, drones: int, duration: float, name: str) -> None:
        """Refuse a drone or a time that the flight does not have; `name` stands before the field in the error.

        Raises:
            ScenarioError: one line.
        """
        if self.drone is not None and self.drone >= drones:
            raise ScenarioError(f"{name}.drone: {self.drone} is out of bounds: it must be at most {drones - 1}")
        if self.at >= duration:
            raise ScenarioError(f"{name}.at: {self.at:g} s must be under the duration, {duration:g} s")

    def describe(self) -> str:
        """The fault in a few words, such as `drone 3: no GPS`."""
        figures = {
            "rotor_loss": f" (rotor {self.rotor}, {self.effectiveness or 0:.0%} left)",
            "gps_jump": f" by ({', '.join(f'{metres:g}' for metres in self.jump or ())}) m",
            "packet_loss": f" ({self.share or 0:.0%})",
        }
        who = "all drones" if self.drone is None else f"drone {self.drone}"
        return f"{who}: {KINDS[self.kind].text}{figures.get(self.kind, '')}"
