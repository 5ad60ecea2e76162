"""One vehicle of a deployed flock: its flight phase, the commands sent to it, and who controls it."""

from __future__ import annotations

import enum

from moflock_mj.ground_station.piloting import AutopilotProfile, FlightTask, mode_command, profile_of
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.mavlink.frames import Origin, Triple

_REPEAT_INTERVAL = 0.3
"""Interval at which a command is repeated until HEARTBEAT confirms it, s."""
_UNDER_WAY = 5.0
"""Maximum time for which a command can be in transit, s."""
_COASTING = 3.0
"""Time for which a silent vehicle is assumed to keep its velocity, s: ArduCopter's GUID_TIMEOUT."""


class Stage(enum.StrEnum):
    """Flight phase of a vehicle."""

    GROUND = "on the ground"
    ARMING = "arming"
    CLIMBING = "taking off"
    READY = "at its height"
    FLOCKING = "flocking"
    LEFT = "left the flock"
    TAKEN = "under external control"
    DOWN = "down"


IN_OUR_HANDS = (Stage.ARMING, Stage.CLIMBING, Stage.READY, Stage.FLOCKING)
"""Stages from arming to flocking, in which a vehicle belongs to the flock."""
IN_THE_AIR = (*IN_OUR_HANDS, Stage.LEFT, Stage.TAKEN)


class Member:
    """A vehicle of the flock.

    Args:
        number: number of the drone, from 0.
        vehicle: the vehicle at its ground station.
        origin: origin of the world frame.

    Attributes:
        stage: flight phase.
        task: last assigned task; None before the vehicle is at its height.
        slowed: names of the watchdogs that slow the vehicle now.
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
        """Time of its first setpoint, at its height, s."""
        self._origin = origin
        self._allowed: set[int] = {*self.profile.taking_off, vehicle.mode}
        self._confirmed = True
        self._assigned_at = self._repeat_at = 0.0

    @property
    def system(self) -> int:
        return self.vehicle.system

    @property
    def height(self) -> float:
        """Height above its home, m."""
        return self.vehicle.fix.height if self.vehicle.fix else 0.0

    @property
    def home(self) -> tuple[float, float]:
        """East and north of its home, m; its present position if the home is unknown."""
        home = self.vehicle.home()
        return self.position[:2] if home is None else self._origin.world(home[0], home[1])

    @property
    def obeys(self) -> bool:
        """Whether HEARTBEAT confirms the last assigned task."""
        return self._confirmed

    @property
    def streams(self) -> bool:
        """Whether it still follows setpoints although another task has been assigned."""
        return (
            self.streaming_since > 0
            and not self._confirmed
            and self.vehicle.mode == self.profile.modes[FlightTask.OFFBOARD]
        )

    def settled(self, now: float) -> bool:
        """Whether it is disarmed and no command in transit can arm it."""
        return not self.vehicle.armed and (self._confirmed or now - self._assigned_at > _UNDER_WAY)

    def look(self) -> None:
        """Update position and velocity from telemetry."""
        place = self.vehicle.position(self._origin)
        if place is not None:
            self.position = place
        if self.vehicle.velocity is not None:
            self.velocity = self.vehicle.velocity

    def expected_place(self) -> tuple[float, float, float]:
        """Extrapolated position, east and north, m, and its uncertainty, m; a silent vehicle keeps its velocity."""
        coasting = min(self.vehicle.fix_age, _COASTING) if self.vehicle.fix else 0.0
        x, y, _ = self.position
        vx, vy, _ = self.velocity
        way = coasting * (vx * vx + vy * vy) ** 0.5
        return x + coasting * vx, y + coasting * vy, way / 2

    def climb(self) -> None:
        """Enter the stage CLIMBING, in which only the modes of a take-off are allowed."""
        self.stage = Stage.CLIMBING
        self._allowed = set(self.profile.taking_off)

    def assign(self, task: FlightTask, now: float) -> None:
        """Assign a task; `update` sends its command and repeats it until HEARTBEAT confirms it."""
        wanted = self.profile.modes[task]
        # Commands in transit can still take effect, and so can the end of a take-off, after which PX4 holds.
        pending = set() if self._confirmed and self.task is not None else self._allowed
        self._allowed = {self.vehicle.mode, wanted} | pending
        self.task, self._confirmed, self._assigned_at, self._repeat_at = task, False, now, now

    def update(self, now: float) -> bool:
        """Send a due command; returns False if the vehicle is in a mode that was not requested."""
        mode = self.vehicle.mode
        if self.task is None:
            return mode in self._allowed
        wanted = self.profile.modes[self.task]
        if mode == wanted:
            self._confirmed, self._allowed = True, self._afterwards(wanted)
        elif mode not in self._allowed:
            return False
        elif not self._confirmed and now >= self._repeat_at:
            self.vehicle.send(mode_command(self.vehicle, wanted))
            self._repeat_at = now + _REPEAT_INTERVAL
        return True

    def _afterwards(self, wanted: int) -> set[int]:
        """Allowed modes after the task is confirmed: a return ends with a landing."""
        return {wanted, self.profile.modes[FlightTask.LAND]} if self.task is FlightTask.RETURN else {wanted}
