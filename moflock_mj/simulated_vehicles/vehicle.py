"""One simulated vehicle: modes, arming, take-off, flight, return, landing and failsafes; without sockets or clocks.

`update` takes time and state, and returns setpoints; `message_handler.MessageHandler` passes messages in, and `outbox`
collects the messages to send. The differences between the autopilots are in `ardupilot.py` and `px4.py`.
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
"""Time with such a tilt after which a vehicle counts as lost, s; both are PX4's FD_FAIL_R and FD_FAIL_R_TTRI."""
_LANDED_AFTER = 1.0
"""Time at rest near the ground in a descent after which a vehicle counts as landed, s."""


_TEXT_CHUNK = 50
"""Length of the text of a STATUSTEXT, bytes."""


class Phase(enum.IntEnum):
    """Flight phase of a vehicle; the numbers are MAVLink's landed states."""

    GROUND = mavlink.MAV_LANDED_STATE_ON_GROUND
    AIR = mavlink.MAV_LANDED_STATE_IN_AIR
    TAKEOFF = mavlink.MAV_LANDED_STATE_TAKEOFF
    LANDING = mavlink.MAV_LANDED_STATE_LANDING


class VehicleTask(enum.Enum):
    """Task of a mode in the air."""

    HOLD = enum.auto()
    OFFBOARD = enum.auto()
    TAKEOFF = enum.auto()
    RETURN = enum.auto()
    LAND = enum.auto()


class ReturnPlan(NamedTuple):
    """Return to home: altitude in m above home, speed in m/s, and time to wait over home in s."""

    altitude: float
    speed: float
    wait: float


class Descent(NamedTuple):
    """Descent of a landing: `fast` (m/s) down to `slow_below` (m above home), then `slow` (m/s)."""

    fast: float
    slow: float
    slow_below: float


@dataclasses.dataclass(kw_only=True)
class SetpointRequest:
    """Content of a setpoint message: a velocity or a position.

    Attributes:
        velocity: velocity, m/s, world, or None.
        position: position, m, world, or None.
        time: time of arrival, s.
    """

    velocity: Triple | None
    position: Triple | None
    time: float


class Outgoing(NamedTuple):
    """A message and its target peer; None for all peers."""

    message: Message
    peer: object | None


class Vehicle(abc.ABC):
    """A simulated vehicle.

    Args:
        system: MAVLink system id.
        origin: geographic position of the world frame's origin.
        body: state on the ground.
        boot: time until the position is usable, s.
    """

    autopilot: ClassVar[int]
    capabilities: ClassVar[int]
    tasks: ClassVar[dict[int, VehicleTask]]
    """Tasks by HEARTBEAT's custom_mode; a mode that is absent holds."""
    mode_names: ClassVar[dict[int, str]]
    pilot_mode: ClassVar[int]
    """Mode in which a pilot with a remote control takes over."""

    def __init__(self, system: int, origin: Origin, body: Body, boot: float) -> None:
        self.system = system
        self.origin = origin
        self.time = 0.0
        self.body = body
        self.armed = False
        self.failsafe = False
        """Whether a failsafe, and not the operator, selected the mode."""
        self.phase = Phase.GROUND
        self.home: Triple | None = None
        """Home, m, world; set with the first position and at arming."""
        self.outbox: list[Outgoing] = []
        self.parameters = self.make_parameters()
        self.mode = self.first_mode()
        self.battery = Battery(cells=self.cells())
        self.estimator = Estimator(boot)
        self.shapes: tuple[Polygon | Circle, ...] = ()
        self.fence = FenceStore(self.send, self._take_fence)
        self.breached = False
        self.setpoint: SetpointRequest | None = None
        self.ground_heartbeat: float | None = None
        """Time of the latest heartbeat of the ground station, s; None before the first."""
        self.ground_lost = False
        self.local_origin = body.position
        """Origin of LOCAL_POSITION_NED, m, world: the position at power-on."""
        self._texts = 0
        self._ground = body.position[2]
        self._guide = Guide(body.position[2])
        self._takeoff_altitude = 0.0
        self._leg_since: float | None = None
        self._tilted_since: float | None = None
        self._resting_since: float | None = None
        self._idle_since = 0.0

    # Differences between the autopilots.

    @abc.abstractmethod
    def make_parameters(self) -> ParameterTable: ...

    @abc.abstractmethod
    def first_mode(self) -> int: ...

    @abc.abstractmethod
    def cells(self) -> int:
        """Number of battery cells in series."""

    @abc.abstractmethod
    def base_mode(self) -> int:
        """HEARTBEAT's base_mode without the armed bit."""

    @abc.abstractmethod
    def mode_of(self, message: Message) -> int | None:
        """Mode number that a MAV_CMD_DO_SET_MODE requests, or None."""

    @abc.abstractmethod
    def request_mode(self, mode: int) -> int:
        """Change the mode at the operator's request; returns a MAV_RESULT."""

    @abc.abstractmethod
    def arming_denials(self) -> list[str]:
        """Reasons why the vehicle cannot be armed now, as status texts."""

    @abc.abstractmethod
    def refuse_arming(self, arming_denials: list[str]) -> int:
        """Send the reasons as status texts; returns a MAV_RESULT."""

    @abc.abstractmethod
    def command_takeoff(self, altitude: float) -> int:
        """Take off to a height in m above home, or NaN for the autopilot's default; returns a MAV_RESULT."""

    @abc.abstractmethod
    def command_land(self) -> int:
        """Land here; returns a MAV_RESULT."""

    @abc.abstractmethod
    def command_return(self) -> int:
        """Return; returns a MAV_RESULT."""

    @abc.abstractmethod
    def obey(self, setpoint: SetpointRequest) -> None:
        """Process a setpoint."""

    @abc.abstractmethod
    def watch(self) -> None:
        """Check the conditions of all failsafes, once in each update."""

    @abc.abstractmethod
    def descent(self) -> Descent: ...

    @abc.abstractmethod
    def return_plan(self) -> ReturnPlan: ...

    @abc.abstractmethod
    def disarm_delays(self) -> tuple[float, float]:
        """Times after which an armed vehicle disarms without a take-off, and after a landing, s."""

    @abc.abstractmethod
    def is_ground_station(self, system: int, kind: int) -> bool:
        """Whether a heartbeat of this system and MAV_TYPE is from the ground station that the failsafe watches."""

    @property
    @abc.abstractmethod
    def fence_enabled(self) -> bool:
        """Whether a fence is active."""

    @abc.abstractmethod
    def prearm_denials(self) -> list[str]:
        """Reasons why MAV_SYS_STATUS_PREARM_CHECK is not healthy now; arming can check more."""

    # Commands of an operator.

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
        """Perform the action of the present mode at arming."""

    def disarm(self, *, force: bool) -> int:
        """Disarm; in the air only by force. Returns a MAV_RESULT."""
        if self.phase != Phase.GROUND and not force:
            return int(mavlink.MAV_RESULT_FAILED)
        if self.armed:
            self._disarm()
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def note_ground_heartbeat(self) -> None:
        """Record a heartbeat of the ground station."""
        self.ground_heartbeat = self.time

    # Simulation.

    def update(self, time: float, body: Body, *, gps_lost: bool = False) -> Setpoint:
        """Advance to `time`, s since power-on, with the body's state at that time; returns the setpoint."""
        seconds, self.time, self.body = time - self.time, time, body
        self.estimator.update(time, gps_lost)
        self.battery.drain(seconds, self.phase != Phase.GROUND)
        if self.home is None and self.estimator.position_ready:
            self.home = body.position
        self.fence.update(time)
        self.watch()
        self._detect_crash()
        if self.phase == Phase.GROUND:
            self._disarm_when_idle()
            return self.standing()
        self._progress()
        setpoint = self._guide.step(seconds, body, lowest=self._ground - 0.7)
        return self.standing() if self._powerless() else setpoint

    def _powerless(self) -> bool:
        """Whether the rotors are stopped: on the ground, or with an empty battery."""
        return self.phase == Phase.GROUND or self.battery.remaining <= 0

    def standing(self) -> Setpoint:
        """Setpoint with stopped rotors."""
        return Setpoint(0.0, 0.0, self.body.position[2], True)

    def height(self) -> float:
        """Height above home, or above the place of power-on, m."""
        return self.body.position[2] - (self.home[2] if self.home else self._ground)

    def say(self, text: str, severity: int = mavlink.MAV_SEVERITY_CRITICAL) -> None:
        """Send a status text to all peers, in chunks if it is long; a partial chunk is the last."""
        whole = text.encode()
        self._texts = self._texts % 65535 + 1
        number = self._texts if len(whole) >= _TEXT_CHUNK else 0
        for part in range(len(whole) // _TEXT_CHUNK + 1):
            chunk = whole[part * _TEXT_CHUNK :][:_TEXT_CHUNK]
            self.send(mavlink.MAVLink_statustext_message(severity, chunk, number, part))

    def send(self, message: Message, peer: object | None = None) -> None:
        self.outbox.append(Outgoing(message, peer))

    def set_mode(self, mode: int, *, failsafe: bool = False) -> None:
        """Change the mode, and in the air begin its task."""
        self.mode, self.failsafe = mode, failsafe
        self._leg_since = None
        if self.phase != Phase.GROUND:
            self.begin_task()

    @property
    def task(self) -> VehicleTask:
        return self.tasks.get(self.mode, VehicleTask.HOLD)

    def begin_task(self) -> None:
        """Begin the task of the mode in the air."""
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
        """Take off to a height in m above home."""
        self.phase = Phase.TAKEOFF
        self._takeoff_altitude = (self.home[2] if self.home else self._ground) + altitude
        self._guide.rise(self.body, self._takeoff_altitude, climb)

    def follow_setpoint(self, setpoint: SetpointRequest, speed_max: float) -> None:
        """Follow a setpoint; this ends a take-off in progress."""
        if self.phase == Phase.GROUND:
            self.take_off(self.height(), 1.0)
        self.phase = Phase.AIR
        if setpoint.velocity is not None:
            self._guide.fly(setpoint.velocity, speed_max)
        elif setpoint.position is not None:
            x, y, z = setpoint.position
            self._guide.go((x, y), z, speed=speed_max, climb=2.5, descent=1.5)

    def hold(self) -> None:
        """Stop and hold the position in the present mode."""
        self._guide.hold()

    def is_outside_fence(self, radius: float, altitude: float, shapes: bool) -> bool:
        """Whether the vehicle violates a fence.

        Args:
            radius: maximum distance from home, m; 0 for no limit.
            altitude: maximum altitude above home, m; 0 for no limit.
            shapes: whether polygons and circles apply.
        """
        x, y, _ = self.body.position
        if radius > 0 and self.home and math.hypot(x - self.home[0], y - self.home[1]) > radius:
            return True
        if altitude > 0 and self.height() > altitude:
            return True
        return shapes and breaches(self.shapes, x, y)

    @abc.abstractmethod
    def took_off(self) -> None:
        """Perform the action at the end of a take-off."""

    def _take_fence(self, items: Sequence[Message]) -> None:
        self.shapes = read_fence(items, self.origin)

    def _progress(self) -> None:
        """Advance a take-off, a return or a landing to its next phase."""
        if self.phase == Phase.TAKEOFF and self.body.position[2] > self._takeoff_altitude - 0.3:
            self.phase = Phase.AIR
            self.took_off()
        elif self.task is VehicleTask.RETURN and self.phase == Phase.AIR:
            self._return()
        elif self.phase == Phase.LANDING:
            self._land()

    def _return(self) -> None:
        """Climb, fly home, wait there, then land."""
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
        """Descend, and detect the ground."""
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
        """Perform the autopilot's action after disarming; ArduPilot stays in its mode."""

    def _disarm_when_idle(self) -> None:
        delay, _ = self.disarm_delays()
        if self.armed and delay > 0 and self.time - self._idle_since >= delay:
            self._disarm()

    def _detect_crash(self) -> None:
        """Stop the rotors of a vehicle that has lost control."""
        if not self.armed or self.body.upright > _TILT_LOST:
            self._tilted_since = None
        elif self._tilted_since is None:
            self._tilted_since = self.time
        elif self.time - self._tilted_since >= _TILT_PATIENCE:
            self.say("Crash: Disarming", mavlink.MAV_SEVERITY_EMERGENCY)
            self._disarm()
