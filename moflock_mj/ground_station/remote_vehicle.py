"""A vehicle at its ground station: its latest messages, their times, and the quality of its link."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import math
from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple

from moflock_mj.ground_station.flight_modes import mode_name
from moflock_mj.mavlink.dialect import Message, mavlink
from moflock_mj.mavlink.frames import Origin, Triple, world_of_ned

_TEXTS_MAX = 200
_EVENT_MARK = "\t"
"""Last character of a status text that PX4 also sends as an event."""
_ROUND_TRIPS = 50
_PENDING_MAX = 20
_WINDOW = 10
"""Number of intervals of 1 s over which rate and loss are measured."""


class ReceivedMessage(NamedTuple):
    """A message and the time at which it arrived, s on the ground station's clock."""

    message: Message
    time: float


class StatusText(NamedTuple):
    """Status text of a vehicle.

    Attributes:
        time: time of arrival, s on the ground station's clock.
        severity: MAV_SEVERITY, from 0 (emergency) to 7 (debug).
        text: the whole text, with its chunks joined.
    """

    time: float
    severity: int
    text: str


class Fix(NamedTuple):
    """Global position of a vehicle.

    Attributes:
        time: time of arrival, s on the ground station's clock.
        latitude: latitude, degrees.
        longitude: longitude, degrees.
        altitude: altitude above mean sea level, m.
        height: height above its home, m.
    """

    time: float
    latitude: float
    longitude: float
    altitude: float
    height: float


class LinkQuality:
    """Quality of the link to one vehicle.

    Attributes:
        received: number of received packets.
        lost: number of packets missing in the vehicle's sequence.
        round_trips: latest round-trip times, measured by TIMESYNC, s.
    """

    def __init__(self) -> None:
        self.received = 0
        self.lost = 0
        self.round_trips: collections.deque[float] = collections.deque(maxlen=_ROUND_TRIPS)
        self._history: collections.deque[tuple[float, int, int]] = collections.deque(maxlen=_WINDOW + 1)
        self._pending: dict[int, float] = {}

    @property
    def rate(self) -> float:
        """Received packets per second over the last seconds; 0 before the second call of `look`."""
        if len(self._history) < 2:
            return 0.0
        (before, received, _), (now, received_now, _) = self._history[0], self._history[-1]
        return (received_now - received) / max(now - before, 1e-9)

    @property
    def loss(self) -> float:
        """Share of lost packets over the last seconds."""
        if len(self._history) < 2:
            return 0.0
        (_, received, lost), (_, received_now, lost_now) = self._history[0], self._history[-1]
        sent = received_now - received + lost_now - lost
        return (lost_now - lost) / sent if sent else 0.0

    @property
    def round_trip(self) -> float:
        """Median of the latest round-trip times, s; NaN before the first."""
        trips = sorted(self.round_trips)
        return trips[len(trips) // 2] if trips else math.nan

    def look(self, time: float) -> None:
        """Store the counts; called once a second."""
        self._history.append((time, self.received, self.lost))

    def count(self, lost: int) -> None:
        """Count a packet and the packets that are missing before it."""
        self.received += 1
        self.lost += lost

    def ask(self, time: float) -> None:
        """Record a TIMESYNC that is sent now."""
        stamp = timesync_stamp(time)
        if len(self._pending) >= _PENDING_MAX:
            del self._pending[next(iter(self._pending))]
        self._pending[stamp] = time

    def answered(self, stamp: int, time: float) -> None:
        """Record the answer to a TIMESYNC."""
        sent = self._pending.pop(stamp, None)
        if sent is not None:
            self.round_trips.append(time - sent)


class RemoteVehicle:
    """One vehicle, identified by its system id.

    Args:
        system: system id.
        where: address, for messages to the user.
        is_local: whether its packets stay on this machine.
        send: function that sends a message to the vehicle.
        clock: function that returns the time, s.

    Attributes:
        latest: last received message, by message name.
        rivals: other addresses that send with its system id; their messages are ignored.
    """

    def __init__(
        self, system: int, where: str, *, is_local: bool, send: Callable[[Message], None], clock: Callable[[], float]
    ) -> None:
        self.system = system
        self.where = where
        self.is_local = is_local
        self.send = send
        self.latest: dict[str, ReceivedMessage] = {}
        self.texts: collections.deque[StatusText] = collections.deque(maxlen=_TEXTS_MAX)
        self.link = LinkQuality()
        self.rivals: set[str] = set()
        self.fix: Fix | None = None
        self.velocity: Triple | None = None
        """Velocity, east, north, up, m/s, world."""
        self._clock = clock
        self._waiting: list[tuple[Collection[str], Callable[[Message], bool], asyncio.Future[Message]]] = []

    def __str__(self) -> str:
        return f"vehicle {self.system} at {self.where}"

    # State reported by the vehicle.

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
        """Whether it reports an active failsafe."""
        return int(self.latest["HEARTBEAT"].message.system_status) >= int(mavlink.MAV_STATE_CRITICAL)

    @property
    def landed(self) -> bool | None:
        """Whether it is on the ground; None if not reported."""
        latest = self.latest.get("EXTENDED_SYS_STATE")
        state = latest.message.landed_state if latest else mavlink.MAV_LANDED_STATE_UNDEFINED
        if state == mavlink.MAV_LANDED_STATE_UNDEFINED:
            return None
        return bool(state == mavlink.MAV_LANDED_STATE_ON_GROUND)

    @property
    def battery(self) -> float | None:
        """Remaining share of charge; None if not reported."""
        latest = self.latest.get("SYS_STATUS") or self.latest.get("BATTERY_STATUS")
        share = latest.message.battery_remaining if latest else -1
        return share / 100 if share >= 0 else None

    @property
    def last_received(self) -> float:
        """Time at which its last message arrived, s on the ground station's clock."""
        return max(received.time for received in self.latest.values())

    def message(self, name: str) -> Message | None:
        """The last message of a name, or None."""
        received = self.latest.get(name)
        return received.message if received else None

    def age(self, name: str) -> float:
        """Time since the last message of a name arrived, s; infinite before the first."""
        received = self.latest.get(name)
        return self._clock() - received.time if received else math.inf

    @property
    def fix_age(self) -> float:
        """Age of its position, s: time since its arrival plus half a round trip."""
        if self.fix is None:
            return math.inf
        trip = self.link.round_trips[-1] if self.link.round_trips else 0.0
        return self._clock() - self.fix.time + trip / 2

    def position(self, origin: Origin) -> Triple | None:
        """Position in the world frame at this origin, m; None before the first fix."""
        if self.fix is None:
            return None
        east, north = origin.world(self.fix.latitude, self.fix.longitude)
        return east, north, self.fix.altitude - origin.altitude

    def home(self) -> tuple[float, float, float] | None:
        """Latitude, longitude (degrees) and altitude (m above mean sea level) of its home; None if not reported."""
        home = self.message("HOME_POSITION")
        return None if home is None else (home.latitude / 1e7, home.longitude / 1e7, home.altitude / 1e3)

    # Received messages.

    def note(self, message: Message, lost: int = 0) -> None:
        """Process a message of this vehicle and the number of packets that are missing before it."""
        now, name = self._clock(), message.get_type()
        self.link.count(lost)
        self.latest[name] = ReceivedMessage(message, now)
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
        """Future of the next message that has one of these names and fits."""
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
            return  # ArduPilot's value before its first position
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
            self.texts[-1] = self.texts[-1]._replace(text=text.removesuffix(_EVENT_MARK))
        else:
            self.texts.append(StatusText(now, message.severity, message.text.removesuffix(_EVENT_MARK)))


def timesync_stamp(time: float) -> int:
    """Time stamp of a TIMESYNC request, ns; never 0, which would mark an answer."""
    return int(time * 1e9) + 1
