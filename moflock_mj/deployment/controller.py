"""Controller of a deployed flock: monitors all vehicles, computes setpoints and sends commands 20 times a second."""

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
"""Interval of setpoints to each vehicle, s: PX4 requires more than 2 Hz, and both autopilots are smooth at 20 Hz."""

_HEIGHT_GAIN = 0.8
"""Gain from height error to climb rate, 1/s."""
_CLIMB_MAX = 1.0
"""Maximum climb rate of the height controller, m/s."""
_AT_HEIGHT = 0.6
"""Maximum height error at the end of a take-off, m; ArduCopter's take-off ends within 0.1 m."""
_SETTLED = 0.5
"""Maximum vertical speed at the end of a take-off, m/s."""
_LAYER = 6.0
"""Height difference to the flock, m, from which a vehicle need not be avoided."""
_RANK = (FlightTask.OFFBOARD, FlightTask.HOLD, FlightTask.RETURN, FlightTask.LAND)
"""Tasks in the order in which they may follow each other."""
_TASKS = {Action.HOLD: FlightTask.HOLD, Action.RETURN: FlightTask.RETURN, Action.LAND: FlightTask.LAND}


class Recorder(Protocol):
    """Recorder of a deployment; see `moflock_mj.deployment.recorder`."""

    def event(self, level: str, text: str, drone: int = -1) -> None: ...

    def sample(self, flock: Controller) -> None:
        """Record the flock's state, once in each period of the controller."""
        ...


class Controller:
    """Controller that flies a flock of vehicles with the policy.

    Args:
        params: parameters of the policy.
        scenario: scenario with speeds, arena and height.
        members: vehicles, by number.
        ground: ground station with the vehicles' links.
        watchdogs: watchdogs of each vehicle.
        recorder: receiver of events and samples.

    Attributes:
        flocking: whether the policy flies the ready vehicles; otherwise they keep their positions.
        desired: horizontal velocities of the latest setpoints, (2, N), m/s, world.
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
        """Run a tick each `PERIOD` until cancelled."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            now = loop.time()
            self._ground.heartbeats_enabled = self.health.take(now, now - due)
            for level, text in self.health.new_events():
                self._recorder.event(level, text)
            self.tick(now)
            due = max(due + PERIOD, loop.time() - PERIOD)
            await asyncio.sleep(max(due - loop.time(), 0))

    def tick(self, now: float) -> None:
        """Update states, run the watchdogs, compute velocities, send setpoints, record."""
        for member in self.members:
            member.look()
        for member in self.members:
            self._update_stage(member, now)
        self._run_watchdogs(now)
        self._watch_ids()
        self._steer()
        self._command(now)
        self._recorder.sample(self)

    def leave(self, member: Member, task: FlightTask, now: float) -> None:
        """Remove a vehicle from the flock and let it hold, return or land; a landing is never aborted."""
        if member.stage is Stage.LEFT and member.task is not None and _RANK.index(task) <= _RANK.index(member.task):
            return
        if member.stage in (*IN_OUR_HANDS, Stage.LEFT):
            member.stage = Stage.LEFT
            member.assign(task, now)

    def leave_all(self, task: FlightTask) -> None:
        """Let all vehicles under our control hold, return or land."""
        now = asyncio.get_running_loop().time()
        for member in self.members:
            self.leave(member, task, now)

    def _update_stage(self, member: Member, now: float) -> None:
        """Update the stage of a vehicle from its telemetry, and detect that it is no longer under our control."""
        vehicle = member.vehicle
        if member.stage in IN_THE_AIR and member.stage is not Stage.ARMING and member.settled(now):
            where = "landed" if vehicle.landed is not False else "disarmed in the air"
            level = "info" if member.stage is Stage.LEFT and vehicle.landed is not False else "error"
            member.stage = Stage.DOWN
            self._report(member, level, where)
            return
        if member.stage in (*IN_OUR_HANDS, Stage.LEFT) and not member.update(now):
            control = "its failsafe" if vehicle.critical else "external control"
            member.stage = Stage.TAKEN
            self._report(member, "warning", f"under {control}, in {vehicle.mode_name}: no longer commanded")
        if member.stage is Stage.CLIMBING and self._is_at_height(member):
            member.stage, member.streaming_since = Stage.READY, now
        elif member.stage is Stage.READY and member.task is None:
            if now - member.streaming_since > STREAM_FIRST:
                member.assign(FlightTask.OFFBOARD, now)
        elif member.stage is Stage.READY and self.flocking and member.obeys:
            member.stage = Stage.FLOCKING

    def _is_at_height(self, member: Member) -> bool:
        off = abs(member.height - self.scenario.altitude)
        return off < _AT_HEIGHT and abs(member.velocity[2]) < _SETTLED

    def _run_watchdogs(self, now: float) -> None:
        """Run the watchdogs of each vehicle in the air that is under our control."""
        nearest = self._nearest()
        for member in self.members:
            if member.stage not in IN_OUR_HANDS:
                continue
            vehicle = member.vehicle
            snapshot = VehicleSnapshot(
                position=member.position,
                velocity=member.velocity,
                fix_age=vehicle.fix_age,
                silence=now - vehicle.last_received,
                battery=vehicle.battery,
                nearest=nearest[member.number] if member.stage is Stage.FLOCKING else math.inf,
            )
            found = alarms(snapshot, self._watchdogs, self.arena, self.scenario.tau)
            self._act(member, found, now)

    def _watch_ids(self) -> None:
        """Report a second sender with a vehicle's system id; the ground station accepts only the first."""
        for member in self.members:
            rivals = member.vehicle.rivals - self._rivals
            if rivals:
                self._rivals |= rivals
                addresses = ", ".join(sorted(rivals))
                self._report(member, "error", f"system id {member.system} is also used by {addresses}")

    def _act(self, member: Member, found: list[Alarm], now: float) -> None:
        before = member.slowed
        member.slowed = frozenset(alarm.name for alarm in found if alarm.action is Action.SLOW)
        for alarm in found:
            if alarm.action is not Action.SLOW:
                self._report(member, "warning", f"{alarm.text}: {alarm.action}")
                self.leave(member, _TASKS[alarm.action], now)
                return
            if alarm.name not in before:
                self._report(member, "warning", f"{alarm.text}: slowed")
        for name in sorted(before - member.slowed):
            self._report(member, "info", f"{name}: over")

    def _nearest(self) -> list[float]:
        """Distance from each vehicle to the nearest vehicle in the air, m."""
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
        """Compute the velocities of the flock with the policy; those of other vehicles are zero."""
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
        """Whether a vehicle is in the flock's height layer without belonging to the flock."""
        outside = member.stage in (Stage.LEFT, Stage.TAKEN, Stage.CLIMBING)
        return outside and abs(member.height - self.scenario.altitude) < _LAYER

    def _command(self, now: float) -> None:
        """Send a setpoint to each vehicle that needs one.

        A vehicle that left the flock gets setpoints until its new mode is confirmed: a command can get lost, and PX4
        treats the end of the stream as a failure.
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

    def _report(self, member: Member, level: str, text: str) -> None:
        self._recorder.event(level, f"drone {member.number} (system {member.system}): {text}", member.number)
