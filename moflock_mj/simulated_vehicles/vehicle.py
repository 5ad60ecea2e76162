"""One simulated vehicle: modes, arming, take-off, flight, return, landing and failsafes; without sockets or clocks.

Time and the body's state go in by `update`, messages by `conversation.Conversation`; setpoints come out of
`update`, messages gather in `outbox`. What differs between the autopilots is in `ardupilot.py` and `px4.py`.
"""

from __future__ import annotations

import abc
import dataclasses
import enum
import math
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

from moflock_mj.mavlink.dialect import Message, mavlink
from moflock_mj.mavlink.fence import Circle, Polygon, breaches, read_fence
from moflock_mj.mavlink.frames import Origin, Triple
from moflock_mj.simulated_vehicles.fence_protocol import FenceStore
from moflock_mj.simulated_vehicles.guidance import Body, Guide, Setpoint
from moflock_mj.simulated_vehicles.parameter_table import ParameterTable
from moflock_mj.simulated_vehicles.vehicle_health import Battery, Estimator

_TILT_LOST = math.cos(math.radians(60))
_TILT_PATIENCE = 0.3
"""s of such a tilt, after which a vehicle counts as lost; both as PX4 has them (FD_FAIL_R, FD_FAIL_R_TTRI)."""
_LANDED_AFTER = 1.0
"""s at rest near the ground in a descent, after which a vehicle counts as landed."""


_TEXT_CHUNK = 50
"""Bytes of a STATUSTEXT."""


class Phase(enum.IntEnum):
    """Where a vehicle is; the numbers are MAVLink's landed states."""

    GROUND = mavlink.MAV_LANDED_STATE_ON_GROUND
    AIR = mavlink.MAV_LANDED_STATE_IN_AIR
    TAKEOFF = mavlink.MAV_LANDED_STATE_TAKEOFF
    LANDING = mavlink.MAV_LANDED_STATE_LANDING


class VehicleTask(enum.Enum):
    """What a mode makes a vehicle in the air do."""

    HOLD = enum.auto()
    OFFBOARD = enum.auto()
    TAKEOFF = enum.auto()
    RETURN = enum.auto()
    LAND = enum.auto()


class ReturnPlan(NamedTuple):
    """How a vehicle comes home: heights in m above home, speeds in m/s, `wait` in s over home."""

    altitude: float
    speed: float
    wait: float


class Descent(NamedTuple):
    """How a vehicle lands: `fast` (m/s) down to `slow_below` (m above home), then `slow`."""

    fast: float
    slow: float
    slow_below: float


@dataclasses.dataclass(kw_only=True)
class SetpointRequest:
    """What a setpoint message asked for: a velocity, or a place and a height, in our world.

    Attributes:
        velocity: m/s, or None.
        position: m, or None.
        time: s, when it came.
    """

    velocity: Triple | None
    position: Triple | None
    time: float


class Outgoing(NamedTuple):
    """A message, and the peer that it is for; None: for all."""

    message: Message
    peer: object | None


class Vehicle(abc.ABC):
    """A simulated vehicle.

    Args:
        system: MAVLink system id.
        origin: the world's place on the globe.
        body: its state on the ground.
        boot: s, until its position can be used.
    """

    autopilot: ClassVar[int]
    capabilities: ClassVar[int]
    tasks: ClassVar[dict[int, VehicleTask]]
    """By mode number, as HEARTBEAT's custom_mode has it; a mode that is absent holds."""
    mode_names: ClassVar[dict[int, str]]
    pilot_mode: ClassVar[int]
    """In which somebody with a remote control takes over."""

    def __init__(self, system: int, origin: Origin, body: Body, boot: float) -> None:
        self.system = system
        self.origin = origin
        self.time = 0.0
        self.body = body
        self.armed = False
        self.failsafe = False
        """Whether a failsafe, and not its operator, chose the mode."""
        self.phase = Phase.GROUND
        self.home: Triple | None = None
        """m, world; set with the first position and at arming."""
        self.outbox: list[Outgoing] = []
        self.parameters = self.make_parameters()
        self.mode = self.first_mode()
        self.battery = Battery(cells=self.cells())
        self.estimator = Estimator(boot)
        self.shapes: tuple[Polygon | Circle, ...] = ()
        self.fence = FenceStore(self.send, self._take_fence)
        self.breached = False
        self.setpoint: SetpointRequest | None = None
        self.ground_heard: float | None = None
        """s, when the latest heartbeat of the ground station came."""
        self.ground_lost = False
        self.local_origin = body.position
        """m, world, from which the vehicle counts LOCAL_POSITION_NED: where it was switched on."""
        self._texts = 0
        self._ground = body.position[2]
        self._guide = Guide(body.position[2])
        self._takeoff_altitude = 0.0
        self._leg_since: float | None = None
        self._tilted_since: float | None = None
        self._resting_since: float | None = None
        self._idle_since = 0.0

    # What the autopilots differ in.

    @abc.abstractmethod
    def make_parameters(self) -> ParameterTable: ...

    @abc.abstractmethod
    def first_mode(self) -> int: ...

    @abc.abstractmethod
    def cells(self) -> int:
        """Cells of the battery in series."""

    @abc.abstractmethod
    def base_mode(self) -> int:
        """HEARTBEAT's base_mode without the armed bit."""

    @abc.abstractmethod
    def mode_of(self, message: Message) -> int | None:
        """The mode number that a MAV_CMD_DO_SET_MODE asks for, or None."""

    @abc.abstractmethod
    def request_mode(self, mode: int) -> int:
        """Change the mode as an operator asks; returns a MAV_RESULT."""

    @abc.abstractmethod
    def arming_denials(self) -> list[str]:
        """Why the vehicle cannot be armed now, as its status texts have it."""

    @abc.abstractmethod
    def refuse_arming(self, arming_denials: list[str]) -> int:
        """Tell why; returns a MAV_RESULT."""

    @abc.abstractmethod
    def command_takeoff(self, altitude: float) -> int:
        """Take off to a height in m above home, NaN for the autopilot's own; returns a MAV_RESULT."""

    @abc.abstractmethod
    def command_land(self) -> int:
        """Land here; returns a MAV_RESULT."""

    @abc.abstractmethod
    def command_return(self) -> int:
        """Return; returns a MAV_RESULT."""

    @abc.abstractmethod
    def obey(self, setpoint: SetpointRequest) -> None:
        """Take a setpoint."""

    @abc.abstractmethod
    def watch(self) -> None:
        """Look for what a failsafe answers, once in each update."""

    @abc.abstractmethod
    def descent(self) -> Descent: ...

    @abc.abstractmethod
    def return_plan(self) -> ReturnPlan: ...

    @abc.abstractmethod
    def disarm_delays(self) -> tuple[float, float]:
        """s, after which an armed vehicle that does not take off disarms, and one that has landed."""

    @abc.abstractmethod
    def is_ground_station(self, system: int, kind: int) -> bool:
        """Whether the heartbeat of this system and MAV_TYPE is that of the ground station which must not be lost."""

    @property
    @abc.abstractmethod
    def fence_enabled(self) -> bool:
        """Whether a fence is watched."""

    @abc.abstractmethod
    def prearm_denials(self) -> list[str]:
        """Why SYS_STATUS's bit MAV_SYS_STATUS_PREARM_CHECK is not healthy now; arming may look at more."""

    # What an operator does.

    def arm(self, *, force: bool) -> int:
        """Arm; returns a MAV_RESULT."""
        if self.armed:
            return int(mavlink.MAV_RESULT_ACCEPTED)
        arming_denials = [] if force else self.arming_denials()
        if arming_denials:
            return self.refuse_arming(arming_denials)
        self.armed = True
        self._idle_since = self.time
        if self.estimator.position_ready:
            self.home = self.body.position
        self.say("Arming motors", mavlink.MAV_SEVERITY_INFO)
        self.armed_in_mode()
        return int(mavlink.MAV_RESULT_ACCEPTED)

    @abc.abstractmethod
    def armed_in_mode(self) -> None:
        """Do what the present mode does at arming."""

    def disarm(self, *, force: bool) -> int:
        """Disarm; in the air only by force. Returns a MAV_RESULT."""
        if self.phase != Phase.GROUND and not force:
            return int(mavlink.MAV_RESULT_FAILED)
        if self.armed:
            self._disarm()
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def hear_ground(self) -> None:
        """Take note of a heartbeat of the ground station."""
        self.ground_heard = self.time

    # What happens.

    def update(self, time: float, body: Body, *, gps_lost: bool = False) -> Setpoint:
        """Go on to `time`, s since it was switched on, with the body's state then; returns what it is to do."""
        seconds, self.time, self.body = time - self.time, time, body
        self.estimator.update(time, gps_lost)
        self.battery.drain(seconds, self.phase != Phase.GROUND)
        if self.home is None and self.estimator.position_ready:
            self.home = body.position
        self.fence.update(time)
        self.watch()
        self._notice_crash()
        if self.phase == Phase.GROUND:
            self._disarm_when_idle()
            return self.standing()
        self._progress()
        setpoint = self._guide.step(seconds, body, lowest=self._ground - 0.7)
        return self.standing() if self._powerless() else setpoint

    def _powerless(self) -> bool:
        """Whether the rotors stand still: on the ground, or with an empty battery."""
        return self.phase == Phase.GROUND or self.battery.remaining <= 0

    def standing(self) -> Setpoint:
        """Rotors still."""
        return Setpoint(0.0, 0.0, self.body.position[2], True)

    def height(self) -> float:
        """Height above home, or above where it was switched on, m."""
        return self.body.position[2] - (self.home[2] if self.home else self._ground)

    def say(self, text: str, severity: int = mavlink.MAV_SEVERITY_CRITICAL) -> None:
        """Send a status text to all, in chunks if it is long; a chunk that is not full is the last."""
        whole = text.encode()
        self._texts = self._texts % 65535 + 1
        number = self._texts if len(whole) >= _TEXT_CHUNK else 0
        for part in range(len(whole) // _TEXT_CHUNK + 1):
            chunk = whole[part * _TEXT_CHUNK :][:_TEXT_CHUNK]
            self.send(mavlink.MAVLink_statustext_message(severity, chunk, number, part))

    def send(self, message: Message, peer: object | None = None) -> None:
        self.outbox.append(Outgoing(message, peer))

    def set_mode(self, mode: int, *, failsafe: bool = False) -> None:
        """Change the mode, and in the air what is done."""
        self.mode, self.failsafe = mode, failsafe
        self._leg_since = None
        if self.phase != Phase.GROUND:
            self.begin_task()

    @property
    def task(self) -> VehicleTask:
        return self.tasks.get(self.mode, VehicleTask.HOLD)

    def begin_task(self) -> None:
        """Begin, in the air, what the mode does."""
        self.phase = Phase.AIR
        if self.task is VehicleTask.LAND:
            self.phase = Phase.LANDING
            self._guide.hold()
        elif self.task is VehicleTask.RETURN and self.home is not None:
            plan, (x, y, z) = self.return_plan(), self.body.position
            self._guide.hold()
            self._guide.go((x, y), max(self.home[2] + plan.altitude, z), speed=2.0, climb=2.5, descent=1.5)
        else:
            self._guide.hold()

    def take_off(self, altitude: float, climb: float) -> None:
        """Leave the ground for a height in m above home."""
        self.phase = Phase.TAKEOFF
        self._takeoff_altitude = (self.home[2] if self.home else self._ground) + altitude
        self._guide.rise(self.body, self._takeoff_altitude, climb)

    def fly_wish(self, setpoint: SetpointRequest, speed_max: float) -> None:
        """Fly a setpoint; a take-off that goes on is over."""
        if self.phase == Phase.GROUND:
            self.take_off(self.height(), 1.0)
        self.phase = Phase.AIR
        if setpoint.velocity is not None:
            self._guide.fly(setpoint.velocity, speed_max)
        elif setpoint.position is not None:
            x, y, z = setpoint.position
            self._guide.go((x, y), z, speed=speed_max, climb=2.5, descent=1.5)

    def hold(self) -> None:
        """Stop and stay, in the present mode."""
        self._guide.hold()

    def is_outside_fence(self, radius: float, altitude: float, shapes: bool) -> bool:
        """Whether the vehicle is where a fence forbids it.

        Args:
            radius: m, from home; 0: no bound.
            altitude: m, above home; 0: no bound.
            shapes: whether its polygons and circles count.
        """
        x, y, _ = self.body.position
        if radius > 0 and self.home and math.hypot(x - self.home[0], y - self.home[1]) > radius:
            return True
        if altitude > 0 and self.height() > altitude:
            return True
        return shapes and breaches(self.shapes, x, y)

    @abc.abstractmethod
    def took_off(self) -> None:
        """The take-off has reached its height."""

    def _take_fence(self, items: Sequence[Message]) -> None:
        self.shapes = read_fence(items, self.origin)

    def _progress(self) -> None:
        """See whether a take-off, a return or a landing has come to its next part."""
        if self.phase == Phase.TAKEOFF and self.body.position[2] > self._takeoff_altitude - 0.3:
            self.phase = Phase.AIR
            self.took_off()
        elif self.task is VehicleTask.RETURN and self.phase == Phase.AIR:
            self._return()
        elif self.phase == Phase.LANDING:
            self._land()

    def _return(self) -> None:
        """Climb, then go home, then wait there, then land."""
        if self.home is None:
            self.phase = Phase.LANDING
            return
        plan, (x, y, z) = self.return_plan(), self.body.position
        away = math.hypot(x - self.home[0], y - self.home[1])
        if self._leg_since is None:
            if z < self.home[2] + plan.altitude - 0.5:
                return
            self._leg_since = math.inf
            self._guide.go(
                self.home[:2], max(z, self.home[2] + plan.altitude), speed=plan.speed, climb=2.5, descent=1.5
            )
        if self._leg_since == math.inf and away < 1.0:
            self._leg_since = self.time
        if self.time - self._leg_since >= plan.wait:
            self.phase = Phase.LANDING

    def _land(self) -> None:
        """Descend, and notice the ground."""
        descent, above = self.descent(), self.height()
        self._guide.sink(self._ground - 0.7, descent.slow if above < descent.slow_below else descent.fast)
        resting = above < 0.3 and abs(self.body.velocity[2]) < 0.15
        if not resting:
            self._resting_since = None
        elif self._resting_since is None:
            self._resting_since = self.time
        elif self.time - self._resting_since >= _LANDED_AFTER:
            self._stand()
            self.setpoint = None

    def _stand(self) -> None:
        self.phase, self._resting_since, self._leg_since = Phase.GROUND, None, None
        self._idle_since = self.time - self.disarm_delays()[0] + self.disarm_delays()[1]
        self._guide = Guide(self.body.position[2])

    def _disarm(self) -> None:
        self.armed = self.failsafe = False
        self.say("Disarming motors", mavlink.MAV_SEVERITY_INFO)
        self._stand()
        self.after_disarming()

    def after_disarming(self) -> None:  # noqa: B027
        """Do what the autopilot does then; ArduPilot stays in its mode."""

    def _disarm_when_idle(self) -> None:
        delay, _ = self.disarm_delays()
        if self.armed and delay > 0 and self.time - self._idle_since >= delay:
            self._disarm()

    def _notice_crash(self) -> None:
        """Stop the rotors of a vehicle that has lost control."""
        if not self.armed or self.body.upright > _TILT_LOST:
            self._tilted_since = None
        elif self._tilted_since is None:
            self._tilted_since = self.time
        elif self.time - self._tilted_since >= _TILT_PATIENCE:
            self.say("Crash: Disarming", mavlink.MAV_SEVERITY_EMERGENCY)
            self._disarm()
