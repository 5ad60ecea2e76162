"""Watchdogs of each vehicle of a deployed flock: monitored quantities, limits and actions.

There is no watchdog for an unrequested mode: the vehicle is then under a pilot or its own failsafe, and is not
commanded again.
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
    """Action of a watchdog; after any action but SLOW, the vehicle has left the flock for good."""

    SLOW = "slow"
    HOLD = "hold"
    RETURN = "return"
    LAND = "land"


SLOWED = 0.5
"""Factor on the speed of a slowed vehicle."""


@dataclasses.dataclass(frozen=True)
class Watchdog:
    """Limit and action of a watchdog."""

    limit: float
    action: Action


@dataclasses.dataclass(frozen=True, kw_only=True)
class Watchdogs:
    """All watchdogs of a vehicle.

    Attributes:
        stale: age of the position: time since its arrival plus half a round trip, s.
        lost: time since the last message, s.
        fence: distance of the stopping point outside the arena, m.
        separation: distance to the nearest vehicle in the air, m.
        battery: remaining share of charge.
        keep_off: distance that the flock keeps from a vehicle that left it, m; no action.
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
    """State of one vehicle for the watchdogs.

    Attributes:
        position: position, m, world.
        velocity: velocity, m/s, world.
        fix_age: age of the position, s.
        silence: time since the last message, s.
        battery: remaining share of charge, or None.
        nearest: distance to the nearest vehicle in the air, m.
    """

    position: Triple
    velocity: Triple
    fix_age: float
    silence: float
    battery: float | None
    nearest: float


class Alarm(NamedTuple):
    """Alarm of a watchdog."""

    name: str
    action: Action
    text: str


def alarms(snapshot: VehicleSnapshot, watchdogs: Watchdogs, arena: Arena, stopping: float) -> list[Alarm]:
    """Alarms of a vehicle, worst first.

    Args:
        snapshot: state of the vehicle.
        watchdogs: limits and actions.
        arena: arena of the flight.
        stopping: ratio of stopping distance to speed, s.
    """
    x, y = (snapshot.position[axis] + stopping * snapshot.velocity[axis] for axis in range(2))
    beyond = float(arena.distance_outside((x, y)))
    found = []
    if snapshot.silence > watchdogs.lost.limit:
        found.append(Alarm("lost", watchdogs.lost.action, f"nothing received for {snapshot.silence:.1f} s"))
    if snapshot.battery is not None and snapshot.battery < watchdogs.battery.limit:
        found.append(Alarm("battery", watchdogs.battery.action, f"{100 * snapshot.battery:.0f} % charge left"))
    if beyond > watchdogs.fence.limit:
        found.append(Alarm("fence", watchdogs.fence.action, f"stopping point {beyond:.0f} m outside the arena"))
    if snapshot.nearest < watchdogs.separation.limit:
        found.append(Alarm("separation", watchdogs.separation.action, f"{snapshot.nearest:.1f} m from another vehicle"))
    if snapshot.fix_age > watchdogs.stale.limit:
        found.append(Alarm("stale", watchdogs.stale.action, f"position is {snapshot.fix_age:.1f} s old"))
    return sorted(found, key=lambda alarm: alarm.action == Action.SLOW)
