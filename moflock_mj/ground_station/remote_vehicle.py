"""A vehicle as its ground station knows it: what it said last, when, and how good its link is."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import math
from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple

from moflock_mj.mavlink.dialect import Message, mavlink
from moflock_mj.mavlink.frames import Origin, Triple, world_of_ned

_TEXTS_MAX = 200
_EVENT_TOO = "\t"
"""With which PX4 ends a status text that it sends as an event, too."""
_ROUND_TRIPS = 50
_PENDING_MAX = 20
_WINDOW = 10
"""Looks, one a second, over which rate and loss are taken."""
_MODE_NAMES = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: {
        0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE",
        9: "LAND", 16: "POSHOLD", 17: "BRAKE", 18: "THROW", 20: "GUIDED_NOGPS", 21: "SMART_RTL",
    },
    mavlink.MAV_AUTOPILOT_PX4: {
        1 << 16: "MANUAL", 2 << 16: "ALTITUDE", 3 << 16: "POSITION", 5 << 16: "ACRO", 6 << 16: "OFFBOARD",
        7 << 16: "STABILIZED", 4 << 16 | 2 << 24: "TAKEOFF", 4 << 16 | 3 << 24: "HOLD", 4 << 16 | 4 << 24: "MISSION",
        4 << 16 | 5 << 24: "RETURN", 4 << 16 | 6 << 24: "LAND",
    },
}  # fmt: skip


class Heard(NamedTuple):
    """A message, and when it came, s on the ground's clock."""

    message: Message
    time: float


class StatusText(NamedTuple):
    """What a vehicle said in words.

    Attributes:
        time: s on the ground's clock.
        severity: MAV_SEVERITY: 0 emergency to 7 debug.
        text: whole, its chunks put together.
    """

    time: float
    severity: int
    text: str


class Fix(NamedTuple):
    """Where a vehicle is.

    Attributes:
        time: s on the ground's clock, when it came.
        latitude: degrees.
        longitude: degrees.
        altitude: m, above mean sea level.
        height: m, above its home.
    """

    time: float
    latitude: float
    longitude: float
    altitude: float
    height: float


class LinkQuality:
    """How good the link to one vehicle is.

    Attributes:
        received: packets.
        lost: packets missing in the vehicle's sequence.
        round_trips: s, the latest ones; measured by TIMESYNC.
    """

    def __init__(self) -> None:
        self.received = 0
        self.lost = 0
        self.round_trips: collections.deque[float] = collections.deque(maxlen=_ROUND_TRIPS)
        self._looks: collections.deque[tuple[float, int, int]] = collections.deque(maxlen=_WINDOW + 1)
        self._asked: dict[int, float] = {}

    @property
    def rate(self) -> float:
        """Packets a second that came, over the last seconds; 0 before two looks."""
        if len(self._looks) < 2:
            return 0.0
        (before, received, _), (now, received_now, _) = self._looks[0], self._looks[-1]
        return (received_now - received) / max(now - before, 1e-9)

    @property
    def loss(self) -> float:
        """Share of the packets that was lost, over the last seconds."""
        if len(self._looks) < 2:
            return 0.0
        (_, received, lost), (_, received_now, lost_now) = self._looks[0], self._looks[-1]
        sent = received_now - received + lost_now - lost
        return (lost_now - lost) / sent if sent else 0.0

    @property
    def round_trip(self) -> float:
        """s, the median of the latest ones; NaN before the first."""
        trips = sorted(self.round_trips)
        return trips[len(trips) // 2] if trips else math.nan

    def look(self, time: float) -> None:
        """Take note of the counts; once a second."""
        self._looks.append((time, self.received, self.lost))

    def count(self, lost: int) -> None:
        """Take note of a packet, and of those that are missing before it."""
        self.received += 1
        self.lost += lost

    def ask(self, time: float) -> None:
        """Take note of a TIMESYNC that is sent now."""
        stamp = timesync_stamp(time)
        if len(self._asked) >= _PENDING_MAX:
            del self._asked[next(iter(self._asked))]
        self._asked[stamp] = time

    def answered(self, stamp: int, time: float) -> None:
        """Take note of the answer to a TIMESYNC."""
        asked = self._asked.pop(stamp, None)
        if asked is not None:
            self.round_trips.append(time - asked)


class RemoteVehicle:
    """One vehicle, by its system id.

    Args:
        system: its id.
        where: its connection and address, for people.
        is_local: whether its packets do not leave this machine.
        send: sends it a message.
        clock: tells the time, s.

    Attributes:
        latest: by message name, the last one that came.
        rivals: other addresses from which somebody speaks in its name; heard by nobody.
    """

    def __init__(
        self, system: int, where: str, *, is_local: bool, send: Callable[[Message], None], clock: Callable[[], float]
    ) -> None:
        self.system = system
        self.where = where
        self.is_local = is_local
        self.send = send
        self.latest: dict[str, Heard] = {}
        self.texts: collections.deque[StatusText] = collections.deque(maxlen=_TEXTS_MAX)
        self.link = LinkQuality()
        self.rivals: set[str] = set()
        self.fix: Fix | None = None
        self.velocity: Triple | None = None
        """m/s, world: east, north, up."""
        self._clock = clock
        self._waiting: list[tuple[Collection[str], Callable[[Message], bool], asyncio.Future[Message]]] = []

    def __str__(self) -> str:
        return f"vehicle {self.system} at {self.where}"

    # What it says of itself.

    @property
    def autopilot(self) -> int:
        """MAV_AUTOPILOT."""
        return int(self.latest["HEARTBEAT"].message.autopilot)

    @property
    def armed(self) -> bool:
        return bool(self.latest["HEARTBEAT"].message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def mode(self) -> int:
        """HEARTBEAT's custom_mode."""
        return int(self.latest["HEARTBEAT"].message.custom_mode)

    @property
    def mode_name(self) -> str:
        return mode_name(self.autopilot, self.mode)

    @property
    def critical(self) -> bool:
        """Whether it says that a failsafe is at work."""
        return int(self.latest["HEARTBEAT"].message.system_status) >= int(mavlink.MAV_STATE_CRITICAL)

    @property
    def landed(self) -> bool | None:
        """Whether it stands on the ground; None: it does not say."""
        told = self.latest.get("EXTENDED_SYS_STATE")
        state = told.message.landed_state if told else mavlink.MAV_LANDED_STATE_UNDEFINED
        if state == mavlink.MAV_LANDED_STATE_UNDEFINED:
            return None
        return bool(state == mavlink.MAV_LANDED_STATE_ON_GROUND)

    @property
    def battery(self) -> float | None:
        """Share of the charge that is left; None: it does not say."""
        told = self.latest.get("SYS_STATUS") or self.latest.get("BATTERY_STATUS")
        share = told.message.battery_remaining if told else -1
        return share / 100 if share >= 0 else None

    @property
    def heard(self) -> float:
        """S on the ground's clock, when its last message came."""
        return max(heard.time for heard in self.latest.values())

    def message(self, name: str) -> Message | None:
        """The last message of a name."""
        heard = self.latest.get(name)
        return heard.message if heard else None

    def age(self, name: str) -> float:
        """S since the last message of a name came; infinite before the first."""
        heard = self.latest.get(name)
        return self._clock() - heard.time if heard else math.inf

    @property
    def fix_age(self) -> float:
        """s, how old its position is: since it came, and half of a round trip before."""
        if self.fix is None:
            return math.inf
        trip = self.link.round_trips[-1] if self.link.round_trips else 0.0
        return self._clock() - self.fix.time + trip / 2

    def position(self, origin: Origin) -> Triple | None:
        """m, in the world at this origin; None before the first fix."""
        if self.fix is None:
            return None
        east, north = origin.world(self.fix.latitude, self.fix.longitude)
        return east, north, self.fix.altitude - origin.altitude

    def home(self) -> tuple[float, float, float] | None:
        """Latitude and longitude (degrees), altitude (m, above mean sea level) of its home; None: not said."""
        home = self.message("HOME_POSITION")
        return None if home is None else (home.latitude / 1e7, home.longitude / 1e7, home.altitude / 1e3)

    # What comes in.

    def note(self, message: Message, lost: int = 0) -> None:
        """Take a message of this vehicle, before which so many are missing."""
        now, name = self._clock(), message.get_type()
        self.link.count(lost)
        self.latest[name] = Heard(message, now)
        if name == "GLOBAL_POSITION_INT":
            self._note_place(message, now)
        elif name == "LOCAL_POSITION_NED":
            self._note_velocity((message.vx, message.vy, message.vz))
        elif name == "STATUSTEXT":
            self._note_text(message, now)
        elif name == "TIMESYNC" and message.tc1:
            self.link.answered(message.ts1, now)
        for names, fits, future in self._waiting:
            if name in names and not future.done() and fits(message):
                future.set_result(message)

    @contextlib.contextmanager
    def expecting(
        self, names: Collection[str], fits: Callable[[Message], bool] = lambda _: True
    ) -> Iterator[asyncio.Future[Message]]:
        """The first message from now on that has one of these names and fits."""
        future: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
        waiting = (names, fits, future)
        self._waiting.append(waiting)
        try:
            yield future
        finally:
            self._waiting.remove(waiting)
            future.cancel()

    def _note_place(self, message: Message, now: float) -> None:
        if message.lat == 0 and message.lon == 0:
            return  # ArduPilot says so before it knows
        if abs(message.lat) > 900_000_000 or abs(message.lon) > 1_800_000_000:
            return
        self.fix = Fix(now, message.lat / 1e7, message.lon / 1e7, message.alt / 1e3, message.relative_alt / 1e3)
        self._note_velocity((message.vx / 100, message.vy / 100, message.vz / 100))

    def _note_velocity(self, ned: Triple) -> None:
        if all(math.isfinite(speed) for speed in ned):
            self.velocity = world_of_ned(ned)

    def _note_text(self, message: Message, now: float) -> None:
        if getattr(message, "chunk_seq", 0) and self.texts:
            text = (self.texts[-1].text + message.text)[:1000]
            self.texts[-1] = self.texts[-1]._replace(text=text.removesuffix(_EVENT_TOO))
        else:
            self.texts.append(StatusText(now, message.severity, message.text.removesuffix(_EVENT_TOO)))


def timesync_stamp(time: float) -> int:
    """ns, of a TIMESYNC; never 0, which would make it an answer."""
    return int(time * 1e9) + 1


def mode_name(autopilot: int, mode: int) -> str:
    """What people call a custom_mode."""
    return _MODE_NAMES.get(autopilot, {}).get(mode, str(mode))
