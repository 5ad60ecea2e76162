"""One vehicle of a deployed flock: how far it is, what it has been told, and who flies it."""

from __future__ import annotations

import enum

from moflock_mj.ground_station.piloting import AutopilotProfile, FlightTask, mode_order, profile_of
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.mavlink.frames import Origin, Triple

_ASK_AGAIN = 0.3
"""s, after which an order that has not shown in HEARTBEAT is given again."""
_UNDER_WAY = 5.0
"""s, for which an order may be on its way, or one that was given before it."""
_COASTING = 3.0
"""s, for which a vehicle that is not heard is taken to fly on: ArduCopter's GUID_TIMEOUT."""


class Stage(enum.StrEnum):
    """How far a vehicle is."""

    GROUND = "on the ground"
    ARMING = "arming"
    CLIMBING = "taking off"
    READY = "at its height"
    FLOCKING = "flocking"
    LEFT = "left the flock"
    TAKEN = "flown by somebody else"
    DOWN = "down"


IN_OUR_HANDS = (Stage.ARMING, Stage.CLIMBING, Stage.READY, Stage.FLOCKING)
"""Stages in which a vehicle belongs to the flock and may leave the ground or has left it."""
IN_THE_AIR = (*IN_OUR_HANDS, Stage.LEFT, Stage.TAKEN)


class Member:
    """A vehicle in its flock.

    Args:
        number: of the drone, from 0.
        vehicle: as its ground station knows it.
        origin: of the world.

    Attributes:
        stage: how far it is.
        task: what it has been told to do last; None before it is at its height.
        slowed: names of the watchdogs that slow it now.
    """

    def __init__(self, number: int, vehicle: RemoteVehicle, origin: Origin) -> None:
        self.number = number
        self.vehicle = vehicle
        self.profile: AutopilotProfile = profile_of(vehicle)
        self.stage = Stage.GROUND
        self.task: FlightTask | None = None
        self.slowed: frozenset[str] = frozenset()
        self.position: Triple = (0.0, 0.0, 0.0)
        self.velocity: Triple = (0.0, 0.0, 0.0)
        self.streaming_since = 0.0
        """s, since when it gets setpoints: at its height."""
        self._origin = origin
        self._allowed: set[int] = {*self.profile.taking_off, vehicle.mode}
        self._confirmed = True
        self._told = self._again = 0.0

    @property
    def system(self) -> int:
        return self.vehicle.system

    @property
    def height(self) -> float:
        """m, above its home."""
        return self.vehicle.fix.height if self.vehicle.fix else 0.0

    @property
    def home(self) -> tuple[float, float]:
        """East and north, m, of where it took off; where it is now, if it does not say."""
        home = self.vehicle.home()
        return self.position[:2] if home is None else self._origin.world(home[0], home[1])

    @property
    def obeys(self) -> bool:
        """Whether HEARTBEAT shows that it does what it has been told."""
        return self._confirmed

    @property
    def streams(self) -> bool:
        """Whether it still flies by setpoints, at its height."""
        return (
            self.streaming_since > 0
            and not self._confirmed
            and self.vehicle.mode == self.profile.modes[FlightTask.OFFBOARD]
        )

    def settled(self, now: float) -> bool:
        """Whether it stays as it is: disarmed, and no order is on its way that could yet arm it."""
        return not self.vehicle.armed and (self._confirmed or now - self._told > _UNDER_WAY)

    def look(self) -> None:
        """Take over where it is."""
        place = self.vehicle.position(self._origin)
        if place is not None:
            self.position = place
        if self.vehicle.velocity is not None:
            self.velocity = self.vehicle.velocity

    def expected_place(self) -> tuple[float, float, float]:
        """East and north, m, where it should be by now, and how wrong that may be: one that is not heard coasts."""
        coasting = min(self.vehicle.fix_age, _COASTING) if self.vehicle.fix else 0.0
        x, y, _ = self.position
        vx, vy, _ = self.velocity
        way = coasting * (vx * vx + vy * vy) ** 0.5
        return x + coasting * vx, y + coasting * vy, way / 2

    def climb(self) -> None:
        """It has left the ground: from now on it is in no mode that a take-off does not need."""
        self.stage = Stage.CLIMBING
        self._allowed = set(self.profile.taking_off)

    def tell(self, task: FlightTask, now: float) -> None:
        """Give it a task; the order goes out with the next `update`, and again until HEARTBEAT shows it."""
        wanted = self.profile.modes[task]
        # Orders that are still under way may yet show, and so may the end of a take-off, after which PX4 holds.
        pending = set() if self._confirmed and self.task is not None else self._allowed
        self._allowed = {self.vehicle.mode, wanted} | pending
        self.task, self._confirmed, self._told, self._again = task, False, now, now

    def update(self, now: float) -> bool:
        """Give orders that are due; returns False if it is in a mode that nobody here has asked for."""
        mode = self.vehicle.mode
        if self.task is None:
            return mode in self._allowed
        wanted = self.profile.modes[self.task]
        if mode == wanted:
            self._confirmed, self._allowed = True, self._afterwards(wanted)
        elif mode not in self._allowed:
            return False
        elif not self._confirmed and now >= self._again:
            self.vehicle.send(mode_order(self.vehicle, wanted))
            self._again = now + _ASK_AGAIN
        return True

    def _afterwards(self, wanted: int) -> set[int]:
        """Modes that it may be in once it has obeyed: a return ends with a landing."""
        return {wanted, self.profile.modes[FlightTask.LAND]} if self.task is FlightTask.RETURN else {wanted}
