"""A fleet of simulated vehicles in real time: dynamics, autopilots and MAVLink endpoints."""

from __future__ import annotations

import asyncio
import dataclasses
import heapq
import itertools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from moflock_mj.errors import FleetError
from moflock_mj.mavlink.dialect import Message
from moflock_mj.mavlink.endpoint import Address, Endpoint, Peer
from moflock_mj.mavlink.frames import Origin
from moflock_mj.mavlink.signing import SigningClock, SigningKey
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulated_vehicles.ardupilot import ArduCopter
from moflock_mj.simulated_vehicles.guidance import Body, Setpoint
from moflock_mj.simulated_vehicles.message_handler import MessageHandler
from moflock_mj.simulated_vehicles.px4 import Px4
from moflock_mj.simulated_vehicles.telemetry import Telemetry
from moflock_mj.simulated_vehicles.vehicle import Phase, Vehicle
from moflock_mj.simulated_vehicles.vehicle_faults import Schedule, VehicleFault, check_faults
from moflock_mj.simulation.initial_state import grid
from moflock_mj.simulation.random_numbers import RandomStreams
from moflock_mj.simulation.realtime_bodies import RealtimeBodies

AUTOPILOTS: dict[str, type[Vehicle]] = {"ardupilot": ArduCopter, "px4": Px4}

TICK = 0.02
"""Update interval of the vehicles, s of simulated time."""
VEHICLES_MAX = 250
"""Maximum number of vehicles: the number of system ids for vehicles."""
_SPEED_MAX = 100.0
_LATE_MAX = 0.5
"""Seconds the loop may lag before it stops catching up."""
_WAITING_MAX = 10_000
"""Maximum number of packets in a delayed link; more are lost."""
_BLIND_DRIFT = 0.035
"""Growth of the velocity error along each axis without GPS, m/s^2: gravity through a tilt error of 0.3 degrees."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class FleetPlan:
    """Plan of a fleet.

    Attributes:
        vehicles: number of vehicles, from 1 to 250; vehicle i has system id i + 1 and port base_port + i.
        autopilot: name in AUTOPILOTS.
        base_port: port of the first vehicle; 0 for any free ports.
        bind: local address on which the vehicles listen.
        to: address to which the vehicles send first, or None.
        speed: simulated seconds per real second.
        spacing: distance between neighbours in the grid on the ground, m.
        boot: simulated time until a vehicle's position is usable, s.
        scenario: scenario with airframe, response, velocity disturbance and GPS errors.
        faults: faults of the vehicles.
        seed: seed of all random numbers.
        origin: geographic position of the world frame's origin.

    Raises:
        FleetError: a value is out of bounds.
    """

    vehicles: int = 1
    autopilot: str = "ardupilot"
    base_port: int = 14600
    bind: str = "127.0.0.1"
    to: Address | None = None
    speed: float = 1.0
    spacing: float = 12.0
    boot: float = 8.0
    scenario: Scenario = dataclasses.field(default_factory=Scenario)
    faults: Sequence[VehicleFault] = ()
    seed: int = 1
    origin: Origin = dataclasses.field(default_factory=Origin)

    def __post_init__(self) -> None:
        if self.autopilot not in AUTOPILOTS:
            raise FleetError(f"autopilot: {self.autopilot!r} is unknown: it must be one of {', '.join(AUTOPILOTS)}")
        bounds = {
            "vehicles": (1, VEHICLES_MAX),
            "base_port": (0, 65536 - self.vehicles),
            "speed": (0.01, _SPEED_MAX),
            "spacing": (0.01, 1000.0),
            "boot": (0.0, 600.0),
            "seed": (0, math.inf),
        }
        for name, (low, high) in bounds.items():
            value = getattr(self, name)
            if not low <= value <= high:
                limits = f"from {low:g} to {high:g}" if math.isfinite(high) else f"at least {low:g}"
                raise FleetError(f"{name}: {value:g} is out of bounds: it must be {limits}")
        check_faults(self.faults, self.vehicles)


class Station:
    """One vehicle, its endpoint, and the faults of both.

    Args:
        number: number of the vehicle, from 0.
        vehicle: simulated autopilot.
        faults: faults of the vehicle and its link.
        rng: random numbers of packet loss.
        key: signing key, or None.
        clock: clock of the signatures.
    """

    def __init__(
        self,
        number: int,
        vehicle: Vehicle,
        faults: Sequence[VehicleFault],
        rng: np.random.Generator,
        key: SigningKey | None,
        clock: SigningClock,
    ) -> None:
        self.number = number
        self.vehicle = vehicle
        self.endpoint = Endpoint(vehicle.system, self._receive, key=key, clock=clock)
        self.address: Address | None = None
        self.telemetry = Telemetry(vehicle, time.time())
        self._message_handler = MessageHandler(vehicle, self.telemetry, lambda: int(vehicle.time * 1e9))
        self.faults = Schedule(faults, self._begin_fault, self._end_fault)
        self._rng = rng
        self._waiting: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()

    def step(self, now: float, body: Body) -> Setpoint:
        """Advance to `now`, s; returns the setpoint of the body."""
        self.faults.update(now)
        setpoint = self.vehicle.update(now, body, gps_lost=self.faults.acting("gps_loss") is not None)
        while self._waiting and self._waiting[0][0] <= now:
            heapq.heappop(self._waiting)[2]()
        self._message_handler.update()
        self._flush()
        for message in self.telemetry.due():
            self._send_to_all(message)
        return setpoint

    def _receive(self, message: Message, peer: Peer) -> None:
        if self.faults.acting("cannot_receive") is None:
            self._carry(lambda: self._answer(message, peer))

    def _answer(self, message: Message, peer: Peer) -> None:
        self._message_handler.answer(message, peer)
        self._flush()

    def _flush(self) -> None:
        outbox, self.vehicle.outbox = self.vehicle.outbox, []
        for message, peer in outbox:
            if isinstance(peer, Peer):
                self._send(message, peer)
            else:
                self._send_to_all(message)

    def _send_to_all(self, message: Message) -> None:
        for peer in list(self.endpoint.peers.values()):
            self._send(message, peer)

    def _send(self, message: Message, peer: Peer) -> None:
        packet = self.endpoint.pack(message, peer)
        if self.faults.acting("cannot_transmit") is None:
            self._carry(lambda: self.endpoint.send_packet(packet, peer))

    def _carry(self, arrive: Callable[[], None]) -> None:
        """Call `arrive` subject to the loss and delay of the link."""
        loss, late = self.faults.acting("link_loss"), self.faults.acting("link_delay")
        if loss is not None and self._rng.random() < (loss.share or 0.0):
            return
        if late is None:
            arrive()
        elif len(self._waiting) < _WAITING_MAX:
            heapq.heappush(self._waiting, (self.vehicle.time + (late.delay or 0.0), next(self._order), arrive))

    def _begin_fault(self, fault: VehicleFault) -> None:
        vehicle = self.vehicle
        if fault.kind == "low_battery":
            vehicle.battery.set_remaining(fault.charge or 0.0)
        elif fault.kind == "duplicate_id":
            self.endpoint.rename(fault.system or vehicle.system)
        elif fault.kind == "pilot":
            vehicle.set_mode(vehicle.pilot_mode)

    def _end_fault(self, fault: VehicleFault) -> None:
        if fault.kind == "duplicate_id":
            self.endpoint.rename(self.vehicle.system)


@dataclasses.dataclass(frozen=True, kw_only=True)
class FleetState:
    """State of a running fleet.

    Attributes:
        time: simulated time, s.
        real_time_factor: simulated over wall time since the previous call, relative to the plan's speed.
        armed: number of armed vehicles.
        flying: number of vehicles in the air.
        modes: number of vehicles in each mode, by name.
        received: packets received by all endpoints.
        dropped: packets dropped by all endpoints.
        lost: packets lost on the way to all endpoints.
        sent: packets sent by all endpoints.
    """

    time: float
    real_time_factor: float
    armed: int
    flying: int
    modes: dict[str, int]
    received: int
    dropped: int
    lost: int
    sent: int


class Fleet:
    """N simulated vehicles, each with its own endpoint.

    Args:
        plan: plan of the fleet.
        key: signing key of the links, or None.

    Raises:
        MoflockError: the airframe cannot be flown, or the plan is invalid for the scenario.
    """

    def __init__(self, plan: FleetPlan, key: SigningKey | None = None) -> None:
        self.plan = plan
        streams = RandomStreams.of(plan.seed)
        places = grid(plan.vehicles, plan.spacing)
        step = plan.scenario.step_for("rigid_body")
        self._steps = round(TICK / step)
        if not math.isclose(self._steps * step, TICK):
            raise FleetError(f"step: {step:g} s: it must divide {TICK:g} s")
        self.bodies = RealtimeBodies(plan.scenario, places, streams, self._steps)
        if 2 * self.bodies.radius >= plan.spacing:
            raise FleetError(
                f"spacing: {plan.spacing:g} m: it must be above the airframe's diameter, {2 * self.bodies.radius:g} m"
            )
        clock = SigningClock()
        make = AUTOPILOTS[plan.autopilot]
        self.stations = [
            Station(
                number,
                make(number + 1, plan.origin, body, plan.boot),
                [fault for fault in plan.faults if fault.vehicle in (number, None)],
                rng,
                key,
                clock,
            )
            for number, (body, rng) in enumerate(
                zip(self._estimates(), streams.communication.spawn(plan.vehicles), strict=True)
            )
        ]
        self._ticks = 0
        self._last_state = (0.0, time.perf_counter())

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self._ticks * TICK

    async def open(self) -> None:
        """Open all endpoints, or none.

        Raises:
            LinkError: a port is in use.
        """
        plan = self.plan
        try:
            for station in self.stations:
                port = plan.base_port + station.number if plan.base_port else 0
                station.address = await station.endpoint.open(plan.bind, port)
                if plan.to is not None:
                    station.endpoint.peer(plan.to)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        for station in self.stations:
            station.endpoint.close()

    async def run(self, duration: float = math.inf, stop: Callable[[], bool] = lambda: False) -> None:
        """Run at the plan's speed for `duration` simulated seconds or until `stop` returns True."""
        begun, done = time.perf_counter(), 0
        period = TICK / self.plan.speed
        while not stop() and self.time < duration - TICK / 2:
            self.tick()
            done += 1
            wait = begun + done * period - time.perf_counter()
            if wait < -_LATE_MAX:
                begun, done = time.perf_counter(), 0
            await asyncio.sleep(max(wait, 0))

    def tick(self) -> None:
        """Update all vehicles and advance the dynamics by TICK."""
        self._ticks += 1
        bodies = self.bodies
        for station, body in zip(self.stations, self._estimates(), strict=True):
            number, setpoint = station.number, station.step(self.time, body)
            bodies.desired[0, number] = setpoint.velocity_x
            bodies.desired[1, number] = setpoint.velocity_y
            bodies.altitude[number] = setpoint.altitude
            bodies.stopped[number] = setpoint.stopped
            failure = station.faults.acting("rotor_failure")
            if failure is not None and failure.rotor is not None:
                bodies.stopped[number, failure.rotor] = 1
            if station.faults.acting("gps_loss") is not None:
                bodies.velocity_error[:, number] += _BLIND_DRIFT * TICK
        bodies.advance(self._steps)

    def state(self) -> FleetState:
        """Return the present state of the fleet."""
        (before, wall_before), now = self._last_state, time.perf_counter()
        self._last_state = (self.time, now)
        vehicles = [station.vehicle for station in self.stations]
        counts = [station.endpoint.counts for station in self.stations]
        modes: dict[str, int] = {}
        for vehicle in vehicles:
            name = vehicle.mode_names.get(vehicle.mode, str(vehicle.mode))
            modes[name] = modes.get(name, 0) + 1
        return FleetState(
            time=self.time,
            real_time_factor=(self.time - before) / max(now - wall_before, 1e-9) / self.plan.speed,
            armed=sum(vehicle.armed for vehicle in vehicles),
            flying=sum(vehicle.phase != Phase.GROUND for vehicle in vehicles),
            modes=modes,
            received=sum(count.received for count in counts),
            dropped=sum(count.dropped for count in counts),
            lost=sum(count.lost for count in counts),
            sent=sum(count.sent for count in counts),
        )

    def _estimates(self) -> list[Body]:
        """Estimated states of all vehicles."""
        bodies = self.bodies
        pose, motion = bodies.qpos.copy(), bodies.qvel.copy()
        pose[:, :2] += bodies.position_error.T
        motion[:, :2] += bodies.velocity_error.T
        poses: list[list[float]] = pose.tolist()
        motions: list[list[float]] = motion.tolist()
        return [_body(pose, motion) for pose, motion in zip(poses, motions, strict=True)]


def _body(pose: list[float], motion: list[float]) -> Body:
    x, y, z, *turn = pose
    vx, vy, vz, *rates = motion
    quaternion: Any = tuple(turn)
    body_rates: Any = tuple(rates)
    return Body((x, y, z), (vx, vy, vz), quaternion, body_rates)
