"""The controller of a deployed flock: 20 times a second it looks at all vehicles, watches, steers and gives orders."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from controllers.policies.interface import Observation
from moflock_mj.deployment.loop_health import Health
from moflock_mj.deployment.member import IN_OUR_HANDS, IN_THE_AIR, Member, Stage
from moflock_mj.deployment.setpoint_timing import Latency
from moflock_mj.deployment.steering import FlockRoles, steer
from moflock_mj.deployment.watchdogs import SLOWED, Action, Alarm, VehicleSnapshot, Watchdogs, alarms
from moflock_mj.ground_station.piloting import STREAM_FIRST, FlightTask, velocity_setpoint
from moflock_mj.ground_station.station import GroundStation
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulation.setup import FlightSetup

PERIOD = 0.05
"""s, between two setpoints to each vehicle: PX4 wants more than 2 Hz, and both are smooth at 20."""

_HEIGHT_GAIN = 0.8
"""1/s, from an error of height to a climb rate."""
_CLIMB_MAX = 1.0
"""m/s, of the correction of height in flight."""
_AT_HEIGHT = 0.6
"""m, how far from its height a vehicle may be to count as there; ArduCopter's take-off ends within 0.1 m of it."""
_SETTLED = 0.5
"""m/s, up or down, under which it does."""
_LAYER = 6.0
"""m, of height between a vehicle and the flock, from which on they need not keep off each other."""
_RANK = (FlightTask.OFFBOARD, FlightTask.HOLD, FlightTask.RETURN, FlightTask.LAND)
"""Tasks, each more final than those before."""
_TASKS = {Action.HOLD: FlightTask.HOLD, Action.RETURN: FlightTask.RETURN, Action.LAND: FlightTask.LAND}


class Recorder(Protocol):
    """Told what happens; see `moflock_mj.deployment.recorder`."""

    def event(self, level: str, text: str, drone: int = -1) -> None: ...

    def sample(self, flock: Controller) -> None:
        """Look at the flock, once in each period of the controller."""
        ...


class Controller:
    """Flies a flock of vehicles by the policy.

    Args:
        params: the policy's parameters.
        scenario: speeds, arena, height.
        members: the vehicles, by number.
        ground: their links.
        watchdogs: watchdogs over each.
        recorder: told what happens.

    Attributes:
        flocking: whether the policy flies those that are ready; else they stay where they are.
        desired: (2, N), m/s, world, of the latest setpoints.
    """

    def __init__(
        self,
        params: NamedTuple,
        scenario: Scenario,
        members: Sequence[Member],
        ground: GroundStation,
        watchdogs: Watchdogs,
        recorder: Recorder,
    ) -> None:
        self.scenario = scenario
        self.members = list(members)
        self.arena = scenario.arena
        self.flocking = False
        self.desired = np.zeros((2, len(self.members)))
        self.latency = Latency(PERIOD, len(self.members))
        self.health = Health(PERIOD)
        self._setup = FlightSetup.resolve(params, scenario)
        self._ground = ground
        self._rivals: set[str] = set()
        self._watchdogs = watchdogs
        self._recorder = recorder
        self._observation = Observation.empty(len(self.members), self.arena.walls)
        self._roles = FlockRoles.none(len(self.members))

    async def run(self) -> None:
        """Tick in time until cancelled."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            now = loop.time()
            self._ground.beating = self.health.take(now, now - due)
            for level, text in self.health.told():
                self._recorder.event(level, text)
            self.tick(now)
            due = max(due + PERIOD, loop.time() - PERIOD)
            await asyncio.sleep(max(due - loop.time(), 0))

    def tick(self, now: float) -> None:
        """Look, watch, steer, command, record."""
        for member in self.members:
            member.look()
        for member in self.members:
            self._follow(member, now)
        self._watch(now)
        self._watch_ids()
        self._steer()
        self._command(now)
        self._recorder.sample(self)

    def leave(self, member: Member, task: FlightTask, now: float) -> None:
        """Take a vehicle out of the flock, and let it hold, return or land; one that lands is not called back."""
        if member.stage is Stage.LEFT and member.task is not None and _RANK.index(task) <= _RANK.index(member.task):
            return
        if member.stage in (*IN_OUR_HANDS, Stage.LEFT):
            member.stage = Stage.LEFT
            member.tell(task, now)

    def leave_all(self, task: FlightTask) -> None:
        """Let all vehicles that are ours to command hold, return or land."""
        now = asyncio.get_running_loop().time()
        for member in self.members:
            self.leave(member, task, now)

    def _follow(self, member: Member, now: float) -> None:
        """See how far a vehicle is, and whether it is still ours."""
        vehicle = member.vehicle
        if member.stage in IN_THE_AIR and member.stage is not Stage.ARMING and member.settled(now):
            where = "landed" if vehicle.landed is not False else "disarmed in the air"
            level = "info" if member.stage is Stage.LEFT and vehicle.landed is not False else "error"
            member.stage = Stage.DOWN
            self._tell(member, level, where)
            return
        if member.stage in (*IN_OUR_HANDS, Stage.LEFT) and not member.update(now):
            who = "its failsafe" if vehicle.critical else "somebody else"
            member.stage = Stage.TAKEN
            self._tell(member, "warning", f"{who} flies it, in {vehicle.mode_name}: not commanded any more")
        if member.stage is Stage.CLIMBING and self._is_at_height(member):
            member.stage, member.streaming_since = Stage.READY, now
        elif member.stage is Stage.READY and member.task is None:
            if now - member.streaming_since > STREAM_FIRST:
                member.tell(FlightTask.OFFBOARD, now)
        elif member.stage is Stage.READY and self.flocking and member.obeys:
            member.stage = Stage.FLOCKING

    def _is_at_height(self, member: Member) -> bool:
        off = abs(member.height - self.scenario.altitude)
        return off < _AT_HEIGHT and abs(member.velocity[2]) < _SETTLED

    def _watch(self, now: float) -> None:
        """Let the watchdogs look at each vehicle of ours that is in the air."""
        nearest = self._nearest()
        for member in self.members:
            if member.stage not in IN_OUR_HANDS:
                continue
            vehicle = member.vehicle
            look = VehicleSnapshot(
                position=member.position,
                velocity=member.velocity,
                fix_age=vehicle.fix_age,
                silence=now - vehicle.heard,
                battery=vehicle.battery,
                nearest=nearest[member.number] if member.stage is Stage.FLOCKING else math.inf,
            )
            found = alarms(look, self._watchdogs, self.arena, self.scenario.tau)
            self._act(member, found, now)

    def _watch_ids(self) -> None:
        """Tell of somebody who speaks in another's name; the ground hears the first alone."""
        for member in self.members:
            rivals = member.vehicle.rivals - self._rivals
            if rivals:
                self._rivals |= rivals
                who = ", ".join(sorted(rivals))
                self._tell(member, "error", f"system id {member.system} is spoken for from elsewhere too: {who}")

    def _act(self, member: Member, found: list[Alarm], now: float) -> None:
        before = member.slowed
        member.slowed = frozenset(alarm.name for alarm in found if alarm.action is Action.SLOW)
        for alarm in found:
            if alarm.action is not Action.SLOW:
                self._tell(member, "warning", f"{alarm.text}: {alarm.action}")
                self.leave(member, _TASKS[alarm.action], now)
                return
            if alarm.name not in before:
                self._tell(member, "warning", f"{alarm.text}: slowed")
        for name in sorted(before - member.slowed):
            self._tell(member, "info", f"{name}: over")

    def _nearest(self) -> list[float]:
        """m, from each vehicle to the next in the air."""
        flying = [member for member in self.members if member.stage in IN_THE_AIR]
        nearest = [math.inf] * len(self.members)
        if len(flying) > 1:
            place = np.array([member.position for member in flying])
            away = np.linalg.norm(place[:, None] - place[None], axis=-1)
            np.fill_diagonal(away, np.inf)
            for member, distance in zip(flying, away.min(axis=0).tolist(), strict=True):
                nearest[member.number] = distance
        return nearest

    def _steer(self) -> None:
        """Let the policy fly those of the flock; the others' velocities are zero."""
        observation, roles = self._observation, self._roles
        for member in self.members:
            i, (x, y, spread) = member.number, member.expected_place()
            flocks = member.stage is Stage.FLOCKING
            observation.own_position[:, i] = member.position[:2]
            observation.own_velocity[:, i] = observation.received_velocity[:, i] = member.velocity[:2]
            observation.received_position[:, i] = member.position[:2] if flocks else (x, y)
            roles.agents[i] = flocks
            roles.avoided[i] = self._is_in_the_way(member)
            roles.keep_off[i] = self._watchdogs.keep_off + spread
        setup = self._setup
        steer(setup.params, setup.limits, setup.arena, self.scenario.r_comm, roles, observation, self.desired)
        for member in self.members:
            if member.slowed:
                self.desired[:, member.number] *= SLOWED

    def _is_in_the_way(self, member: Member) -> bool:
        """Whether a vehicle is in the flock's layer without belonging to the flock."""
        strange = member.stage in (Stage.LEFT, Stage.TAKEN, Stage.CLIMBING)
        return strange and abs(member.height - self.scenario.altitude) < _LAYER

    def _command(self, now: float) -> None:
        """Send a setpoint to each vehicle that flies by them, and to one that is yet to hear that it no longer does.

        An order may get lost; PX4 would take the end of the stream for a failure.
        """
        for member in self.members:
            if member.stage in (Stage.READY, Stage.FLOCKING) or (member.stage is Stage.LEFT and member.streams):
                error = self.scenario.altitude - member.height
                climb = min(max(_HEIGHT_GAIN * error, -_CLIMB_MAX), _CLIMB_MAX)
                east, north = self.desired[:, member.number].tolist()
                vehicle = member.vehicle
                vehicle.send(velocity_setpoint(member.system, (east, north, climb), int(now * 1000)))
                sent = asyncio.get_running_loop().time()
                if member.stage is Stage.FLOCKING and vehicle.fix is not None:
                    self.latency.note(member.number, sent, vehicle.fix.time)

    def _tell(self, member: Member, level: str, text: str) -> None:
        self._recorder.event(level, f"drone {member.number} (system {member.system}): {text}", member.number)
