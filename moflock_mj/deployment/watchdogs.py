"""Watchdogs over each vehicle of a deployed flock: what they look at, their limits, and what they do.

A mode that nobody here has asked for has no action of its own: somebody else flies the vehicle then, a pilot or its own
failsafe, and it is never commanded again.
"""

from __future__ import annotations

import dataclasses
import enum
import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from moflock_mj.errors import DeploymentError
from moflock_mj.mavlink.frames import Triple
from moflock_mj.world.arena import Arena


class Action(enum.StrEnum):
    """What a watchdog does; after all but SLOW the vehicle has left the flock for good."""

    SLOW = "slow"
    HOLD = "hold"
    RETURN = "return"
    LAND = "land"


SLOWED = 0.5
"""Share of its speed that a slowed vehicle keeps."""


@dataclasses.dataclass(frozen=True)
class Watchdog:
    """One watchdog's limit, and its action."""

    limit: float
    action: Action


@dataclasses.dataclass(frozen=True, kw_only=True)
class Watchdogs:
    """All watchdogs over a vehicle.

    Attributes:
        stale: s, age of its position: since it came and half of a round trip before.
        lost: s, in which nothing has come of it.
        fence: m, beyond the arena's wall, where it would come to rest if it braked now.
        separation: m, to the next vehicle in the air.
        battery: share of charge that is left.
        keep_off: m, that the flock keeps off a vehicle which has left it; no action.
    """

    stale: Watchdog = Watchdog(0.5, Action.SLOW)
    lost: Watchdog = Watchdog(3.0, Action.HOLD)
    fence: Watchdog = Watchdog(15.0, Action.HOLD)
    separation: Watchdog = Watchdog(3.0, Action.SLOW)
    battery: Watchdog = Watchdog(0.2, Action.LAND)
    keep_off: float = 8.0

    @classmethod
    def from_texts(cls, texts: Sequence[str]) -> Watchdogs:
        """The defaults, changed by texts such as battery=0.3, battery=return or battery=0.3:return.

        Raises:
            DeploymentError: no such watchdog, limit or action.
        """
        changed: dict[str, Any] = {}
        for text in texts:
            match = re.fullmatch(r"(\w+)=([0-9.eE+]+)?(?::?([a-z]+))?", text)
            name = match[1] if match else ""
            default = getattr(cls(), name, None) if name in {field.name for field in dataclasses.fields(cls)} else None
            if match is None or default is None:
                names = ", ".join(field.name for field in dataclasses.fields(cls))
                raise DeploymentError(f"watchdog {text!r}: must be NAME=LIMIT:ACTION with NAME one of {names}")
            limit = _limit(text, match[2])
            if isinstance(default, Watchdog):
                changed[name] = Watchdog(
                    default.limit if limit is None else limit, _action(text, match[3]) or default.action
                )
            elif limit is None or match[3]:
                raise DeploymentError(f"watchdog {text!r}: {name} has a limit and no action")
            else:
                changed[name] = limit
        return dataclasses.replace(cls(), **changed)


def _limit(text: str, number: str | None) -> float | None:
    if number is None:
        return None
    try:
        limit = float(number)
    except ValueError:
        limit = math.nan
    if not 0 <= limit <= 1000:
        raise DeploymentError(f"watchdog {text!r}: limit {number} is out of bounds: it must be from 0 to 1000")
    return limit


def _action(text: str, name: str | None) -> Action | None:
    if name is None:
        return None
    if name not in set(Action):
        raise DeploymentError(f"watchdog {text!r}: {name!r} is unknown: it must be one of {', '.join(Action)}")
    return Action(name)


class VehicleSnapshot(NamedTuple):
    """What a watchdog sees of one vehicle.

    Attributes:
        position: m, world.
        velocity: m/s, world.
        fix_age: s.
        silence: s, since anything came of it.
        battery: share, or None.
        nearest: m, to the next vehicle in the air.
    """

    position: Triple
    velocity: Triple
    fix_age: float
    silence: float
    battery: float | None
    nearest: float


class Alarm(NamedTuple):
    """What a watchdog has found."""

    name: str
    action: Action
    text: str


def alarms(look: VehicleSnapshot, watchdogs: Watchdogs, arena: Arena, stopping: float) -> list[Alarm]:
    """What is wrong with a vehicle, the worst first.

    Args:
        look: at the vehicle.
        watchdogs: limits and actions.
        arena: where the vehicle may be.
        stopping: s, of its speed, that it takes to brake.
    """
    x, y = (look.position[axis] + stopping * look.velocity[axis] for axis in range(2))
    beyond = float(arena.distance_outside((x, y)))
    found = []
    if look.silence > watchdogs.lost.limit:
        found.append(Alarm("lost", watchdogs.lost.action, f"nothing heard of it for {look.silence:.1f} s"))
    if look.battery is not None and look.battery < watchdogs.battery.limit:
        found.append(Alarm("battery", watchdogs.battery.action, f"{100 * look.battery:.0f} % of its charge left"))
    if beyond > watchdogs.fence.limit:
        found.append(Alarm("fence", watchdogs.fence.action, f"on its way to {beyond:.0f} m outside of the arena"))
    if look.nearest < watchdogs.separation.limit:
        found.append(Alarm("separation", watchdogs.separation.action, f"{look.nearest:.1f} m from another"))
    if look.fix_age > watchdogs.stale.limit:
        found.append(Alarm("stale", watchdogs.stale.action, f"its position is {look.fix_age:.1f} s old"))
    return sorted(found, key=lambda alarm: alarm.action == Action.SLOW)
