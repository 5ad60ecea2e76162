"""A deployment and its stages: connect, check, take off, flock, finish."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import enum
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, NamedTuple

from moflock_mj.deployment.controller import Controller
from moflock_mj.deployment.member import IN_OUR_HANDS, IN_THE_AIR, Member, Stage
from moflock_mj.deployment.prelaunch import check_start, prepare, require_simulated
from moflock_mj.deployment.recorder import DeploymentRecorder, Figures
from moflock_mj.deployment.return_paths import is_clear
from moflock_mj.deployment.steering import compile_policy
from moflock_mj.deployment.watchdogs import Watchdogs
from moflock_mj.errors import CommandError, DeploymentError
from moflock_mj.ground_station import piloting
from moflock_mj.ground_station.origin import find_origin
from moflock_mj.ground_station.piloting import FlightTask
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.ground_station.station import GroundStation, vehicles_at
from moflock_mj.mavlink.addresses import Connection
from moflock_mj.mavlink.frames import Origin
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.metrics.events import FlightEvent
from moflock_mj.scenario.scenario import Scenario

_POLL = 0.05
_CLIMB_SLOWEST = 0.4
"""Minimum climb rate of a vehicle, m/s."""
_SETTLING = 30.0
"""Time for the rest of a take-off, s."""
_LANDING_TIMEOUT = 240.0
"""Time until all vehicles have landed at the end, s."""
_RETURN_TIMEOUT = 60.0
"""Time without a returning vehicle, s, after which vehicles without a clear path land where they are."""
_CLEARANCE = 1.3
"""Clearance between return paths, as a multiple of the separation watchdog's limit."""


class Finish(enum.StrEnum):
    """End of a deployment."""

    HOLD = "hold"
    RETURN = "return"
    LAND = "land"


@dataclasses.dataclass(frozen=True, kw_only=True)
class DeployPlan:
    """Plan of a deployment.

    Attributes:
        params: parameters of the policy.
        scenario: scenario of the flight; its number of drones becomes the number of vehicles.
        connections: addresses of the vehicles.
        count: number of vehicles; None for one on each link.
        autopilot: autopilot that all vehicles must have, "ardupilot" or "px4"; None for either.
        finish: end of the deployment.
        origin: latitude and longitude of the arena's centre, degrees; None for the mean of the vehicles' homes.
        watchdogs: watchdogs of each vehicle.
        rehearse: whether all vehicles must be simulated, and no report is required.
        interval: time between two take-offs, s.
        timeout: time to wait for the vehicles, s.
        log: path of the log, or None.
        metadata: additional metadata of the log.
    """

    params: NamedTuple
    scenario: Scenario
    connections: tuple[Connection, ...]
    count: int | None = None
    autopilot: str | None = None
    finish: Finish = Finish.LAND
    origin: tuple[float, float] | None = None
    watchdogs: Watchdogs = dataclasses.field(default_factory=Watchdogs)
    rehearse: bool = False
    interval: float = 1.0
    timeout: float = 10.0
    log: Path | None = None
    metadata: dict[str, str] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Deployed:
    """Result of a deployment.

    Attributes:
        plan: plan of the deployment, with the number of vehicles.
        origin: origin of the world frame.
        figures: figures of the flight.
        stages: last stage of each vehicle, by its number.
        events: events of the flight.
        error: reason for an early end, or None.
        interrupted: whether the user interrupted it.
        counts: numbers of packets received, lost, dropped and sent.
    """

    plan: DeployPlan
    origin: Origin
    figures: Figures
    stages: tuple[Stage, ...]
    events: tuple[FlightEvent, ...]
    error: str | None
    interrupted: bool
    counts: dict[str, int]


class InterruptHandler:
    """Ctrl-C during a deployment: first press holds all vehicles, second lands them, third releases control.

    Args:
        give_up: function called by a press before any vehicle is armed.
    """

    def __init__(self, give_up: Callable[[], object] = lambda: None) -> None:
        self.in_flight = False
        self._give_up = give_up
        self._pressed = asyncio.Event()

    def press(self) -> None:
        if self.in_flight:
            self._pressed.set()
        else:
            self._give_up()

    async def next(self) -> None:
        """Wait for the next press."""
        await self._pressed.wait()
        self._pressed.clear()


Check = Callable[[list[RemoteVehicle], GroundStation], Awaitable[None]]
"""Check of the vehicles before take-off; raises an error to refuse the deployment."""


async def deploy(
    plan: DeployPlan,
    key: SigningKey | None,
    interrupts: InterruptHandler,
    *,
    check: Check | None = None,
    say: Callable[[FlightEvent], None] = lambda _: None,
) -> Deployed:
    """Deploy a flock.

    Args:
        plan: plan of the deployment.
        key: signing key of the links, or None.
        interrupts: handler of the user's interrupts.
        check: check of the vehicles, for example against a pre-flight report.
        say: callback that receives each event.

    Raises:
        MoflockError: the deployment was refused before any vehicle was armed.
    """
    compile_policy(plan.params, plan.scenario)
    async with vehicles_at(plan.connections, key, count=plan.count, timeout=plan.timeout) as (ground, vehicles):
        plan = dataclasses.replace(plan, scenario=plan.scenario.replace(drones=len(vehicles)))
        profiles = _autopilots(vehicles, plan.autopilot)
        await prepare(vehicles)
        if plan.rehearse:
            await require_simulated(vehicles)
        if check is not None:
            await check(vehicles, ground)
        origin = find_origin(vehicles, plan.origin)
        members = [Member(number, vehicle, origin) for number, vehicle in enumerate(vehicles)]
        for member in members:
            member.look()
        check_start(members, plan.scenario, plan.watchdogs)
        metadata = plan.metadata | {
            "autopilots": ", ".join(sorted(profiles)),
            "origin": f"{origin.latitude:.7f},{origin.longitude:.7f},{origin.altitude:.2f}",
            "vehicles": ", ".join(f"{vehicle.system}@{vehicle.where}" for vehicle in vehicles),
        }
        clock = asyncio.get_running_loop().time
        with DeploymentRecorder(plan.log, plan.params, plan.scenario, members, clock, metadata, say) as record:
            flock = Controller(plan.params, plan.scenario, members, ground, plan.watchdogs, record)
            ground.check_ids()
            flight = _Flight(plan, flock, record, members)
            interrupts.in_flight = True
            with ground.observed_by(record.packet):
                await flight.fly(interrupts)
            figures = record.figures(flock)
            record.finish(figures, flight.error)
        return Deployed(
            plan=plan,
            origin=origin,
            figures=figures,
            stages=tuple(member.stage for member in members),
            events=tuple(record.events),
            error=flight.error,
            interrupted=flight.interrupted,
            counts=vars(ground.counts()),
        )


def _autopilots(vehicles: list[RemoteVehicle], wanted: str | None) -> set[str]:
    """Names of the vehicles' autopilots.

    Raises:
        MoflockError: a vehicle has another autopilot than `wanted`.
    """
    profiles = {vehicle: piloting.profile_of(vehicle).name for vehicle in vehicles}
    for vehicle, profile in profiles.items():
        if wanted not in (None, profile):
            raise DeploymentError(f"{vehicle}: autopilot is {profile}; it must be {wanted}")
    return set(profiles.values())


class _Flight:
    """Stages of a deployment from arming to the end."""

    def __init__(self, plan: DeployPlan, flock: Controller, record: DeploymentRecorder, members: list[Member]) -> None:
        self.error: str | None = None
        self.interrupted = False
        self._plan = plan
        self._flock = flock
        self._record = record
        self._members = members

    async def fly(self, interrupts: InterruptHandler) -> None:
        """Fly the stages while the controller runs, and respond to interrupts."""
        control = asyncio.create_task(self._flock.run())
        job = asyncio.create_task(self._stages_or_land())
        responses = [self._hold, self._land]
        try:
            while not await _done_before(job, control, interrupts):
                self.interrupted = True
                await _cancelled(job)
                if not responses:
                    return
                job = asyncio.create_task(responses.pop(0)())
            await job
        finally:
            await _cancelled(job)
            await _cancelled(control)

    async def _stages_or_land(self) -> None:
        try:
            await self._stages()
        except CommandError as problem:
            self._record.event("error", str(problem))
            await self._land()
            self.error = str(problem)

    async def _stages(self) -> None:
        await self._take_off()
        await self._reach_height()
        await self._fly_policy()
        await self._end()

    async def _take_off(self) -> None:
        """Arm the vehicles and let them take off one after the other, `interval` apart."""
        self._record.event("info", f"{len(self._members)} vehicles take off to {self._plan.scenario.altitude:g} m")
        climbing = []
        try:
            for member in self._members:
                climbing.append(asyncio.create_task(self._lift(member)))
                await asyncio.sleep(self._plan.interval)
                for task in climbing:
                    if task.done():
                        task.result()
            await asyncio.gather(*climbing)
        finally:
            for task in climbing:
                await _cancelled(task)

    async def _lift(self, member: Member) -> None:
        member.stage = Stage.ARMING
        await piloting.take_off(member.vehicle, self._plan.scenario.altitude)
        if member.stage is Stage.ARMING:
            member.climb()

    async def _reach_height(self) -> None:
        """Wait until all vehicles under our control are at their height and follow setpoints."""
        timeout = self._plan.scenario.altitude / _CLIMB_SLOWEST + _SETTLING

        def ready() -> bool:
            ours = self._ours()
            return all(
                member.stage is Stage.READY and member.task is FlightTask.OFFBOARD and member.obeys for member in ours
            )

        if not await _until(ready, timeout):
            slow = next(member for member in self._ours() if member.stage is not Stage.READY or not member.obeys)
            raise CommandError(
                f"{slow.vehicle}: at {slow.height:.1f} m in {slow.vehicle.mode_name} after {timeout:.0f} s; it must "
                f"be at {self._plan.scenario.altitude:g} m and follow setpoints"
            )

    async def _fly_policy(self) -> None:
        """Fly the policy for the scenario's duration, or until no vehicle is left in the flock."""
        self._record.event("info", f"{len(self._ours())} vehicles in the flock")
        self._flock.flocking = True
        try:
            enough = self._plan.scenario.duration - 1e-9
            await _until(lambda: not self._ours() or self._record.flocked >= enough, None)
        finally:
            self._flock.flocking = False
        if not self._ours():
            self.error = "no vehicle is left in the flock"

    async def _end(self) -> None:
        """Hold, return or land all vehicles, as planned."""
        if self._plan.finish is Finish.LAND:
            await self._land()
        elif self._plan.finish is Finish.RETURN:
            await self._return()
        else:
            self._record.event("info", "all vehicles hold")
            self._flock.leave_all(FlightTask.HOLD)
            await _until(lambda: all(member.obeys for member in self._left()), _SETTLING)

    async def _hold(self) -> None:
        """Let all vehicles hold until the next interrupt."""
        self._record.event("warning", "all vehicles hold; interrupt again to land them")
        self._flock.leave_all(FlightTask.HOLD)
        await _until(lambda: not self._left(), None)

    async def _land(self) -> None:
        """Land all vehicles where they are."""
        self._record.event("info", "all vehicles land")
        self._flock.leave_all(FlightTask.LAND)
        await self._all_down()

    async def _return(self) -> None:
        """Return all vehicles, each one as soon as its path is clear of all others."""
        self._record.event("info", "all vehicles return")
        self._flock.leave_all(FlightTask.HOLD)
        loop = asyncio.get_running_loop()
        moved = loop.time()
        while waiting := [member for member in self._left() if member.task is FlightTask.HOLD]:
            for member in waiting:
                if member.obeys and self._may_return(member):
                    self._flock.leave(member, FlightTask.RETURN, loop.time())
            if any(member.task is FlightTask.RETURN for member in self._left()):
                moved = loop.time()
            if loop.time() - moved > _RETURN_TIMEOUT:
                self._record.event("warning", f"{len(waiting)} vehicles have no clear return path: they land")
                self._flock.leave_all(FlightTask.LAND)
            await asyncio.sleep(4 * _POLL)
        await self._all_down()

    def _may_return(self, member: Member) -> bool:
        others = [
            _path(other, homeward=other.task is FlightTask.RETURN)
            for other in self._members
            if other is not member and other.stage in IN_THE_AIR
        ]
        return is_clear(_path(member, homeward=True), others, _CLEARANCE * self._plan.watchdogs.separation.limit)

    async def _all_down(self) -> None:
        if not await _until(lambda: not self._left() or self._all_silent(), _LANDING_TIMEOUT):
            self.error = f"{len(self._left())} vehicles have not landed after {_LANDING_TIMEOUT:.0f} s"
        elif self._all_silent():
            self.error = f"{len(self._left())} vehicles do not respond any more"

    def _ours(self) -> list[Member]:
        return [member for member in self._members if member.stage in IN_OUR_HANDS]

    def _left(self) -> list[Member]:
        """Vehicles that fly under our commands, in the flock or after leaving it."""
        return [member for member in self._members if member.stage in (*IN_OUR_HANDS, Stage.LEFT)]

    def _all_silent(self) -> bool:
        """Whether none of the vehicles under our commands has sent a message for `_SETTLING`."""
        now, left = asyncio.get_running_loop().time(), self._left()
        return bool(left) and all(now - member.vehicle.last_received > _SETTLING for member in left)


def _path(member: Member, *, homeward: bool) -> tuple[tuple[float, float], tuple[float, float]]:
    here = member.position[:2]
    return here, (member.home if homeward else here)


async def _done_before(job: asyncio.Task[None], control: asyncio.Task[None], interrupts: InterruptHandler) -> bool:
    """Whether a job ends before the next interrupt; an error of the controller is raised."""
    interrupt = asyncio.create_task(interrupts.next())
    try:
        await asyncio.wait({job, control, interrupt}, return_when=asyncio.FIRST_COMPLETED)
        if control.done():
            control.result()
        return job.done()
    finally:
        await _cancelled(interrupt)


async def _until(condition: Callable[[], bool], timeout: float | None) -> bool:
    """Wait for a condition; returns whether it came true within `timeout`, s."""
    loop = asyncio.get_running_loop()
    deadline = None if timeout is None else loop.time() + timeout
    while not condition():
        if deadline is not None and loop.time() >= deadline:
            return False
        await asyncio.sleep(_POLL)
    return True


async def _cancelled(task: asyncio.Task[Any]) -> None:
    """Cancel a task, wait for it, and ignore its cancellation or command error."""
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError, CommandError):
        await task
