"""The log of a deployed flight: samples, events and every packet, in the layout of simulated flights.

Its time starts before the take-off; the order parameters cover the time in which the policy flies the flock.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from controllers.policies.registry import spec_of, values_of
from moflock_mj.deployment.controller import Controller
from moflock_mj.deployment.member import Member
from moflock_mj.deployment.setpoint_timing import LatencyFigures
from moflock_mj.deployment.steering import score
from moflock_mj.dynamics.airframe_models import load_airframe
from moflock_mj.ground_station.station import Traffic
from moflock_mj.log.encoder import LinkPacket, LogHeader, SampleBlock
from moflock_mj.log.flight_logger import circumstances, flight_attachments
from moflock_mj.log.writer import FlightLog
from moflock_mj.mavlink.frames import frd_of_flu, quaternion_of_euler
from moflock_mj.metrics.catalogue import METRICS
from moflock_mj.metrics.events import FlightEvent
from moflock_mj.metrics.fitness import Fitness, fitness_of
from moflock_mj.metrics.order_parameters import MetricAccumulator, OrderParameters
from moflock_mj.scenario.scenario import DEPLOYED, Scenario
from moflock_mj.simulation.setup import FlightSetup
from moflock_mj.world.state import TrueState

_BLOCK = 10
"""Number of samples per write."""


class Figures(NamedTuple):
    """Figures of a deployed flight.

    Attributes:
        flocked: time in which the policy flew, s.
        order_parameters: order parameters over that time.
        fitness: their fitness.
        separation_min: smallest distance between two vehicles in that time, m.
        outside_max: largest distance of a vehicle outside the arena in that time, m; 0 if none was outside.
        latency: timing of setpoints; None before the first two.
    """

    flocked: float
    order_parameters: OrderParameters
    fitness: Fitness
    separation_min: float
    outside_max: float
    latency: LatencyFigures | None


class DeploymentRecorder:
    """Recorder of a deployed flight; a context manager that finishes the log.

    Args:
        path: path of the log, or None.
        params: parameters of the policy.
        scenario: scenario of the flight.
        members: the vehicles.
        clock: function that returns the time, s.
        metadata: additional metadata of the log.
        say: callback that receives each event.

    Attributes:
        flocked: time in which the policy has flown, s.

    Raises:
        LogError: the log cannot be written.
    """

    def __init__(
        self,
        path: Path | None,
        params: NamedTuple,
        scenario: Scenario,
        members: Sequence[Member],
        clock: Callable[[], float],
        metadata: Mapping[str, str],
        say: Callable[[FlightEvent], None],
    ) -> None:
        self.path = path
        self.events: list[FlightEvent] = []
        self._scenario = scenario
        self._members = members
        self._clock = clock
        self._say = say
        self._arena = scenario.arena
        self._setup = FlightSetup.resolve(params, scenario)
        drones = len(members)
        self._world = TrueState.at_rest(drones)
        self._accumulator = MetricAccumulator.empty(drones, self._arena.walls)
        self._running = np.zeros(len(METRICS))
        self._flocking_since: float | None = None
        self.flocked = 0.0
        self._over = False
        self._slot = -1
        self._rows: list[tuple[NDArray[Any], ...]] = []
        self._nearest, self._outside = math.inf, 0.0
        self._log = None if path is None else _open(path, params, scenario, metadata)
        self._began = clock()

    @property
    def time(self) -> float:
        """Time since the start of the log, s."""
        return self._clock() - self._began

    def event(self, level: str, text: str, drone: int = -1) -> None:
        """Record an event."""
        severity: Any = level
        event = FlightEvent(round(self.time * 1e9), severity, text, drone)
        self.events.append(event)
        if self._log is not None:
            self._log.event(event)
        self._say(event)

    def packet(self, traffic: Traffic) -> None:
        """Record a packet of a link."""
        if self._log is not None:
            time_ns = max(round((traffic.time - self._began) * 1e9), 0)
            self._log.packet(LinkPacket(time_ns, traffic.system, traffic.is_sent, traffic.packet))

    def sample(self, flock: Controller) -> None:
        """Record a sample, if one is due."""
        now = self.time
        if flock.flocking and self._flocking_since is None:
            self._flocking_since = now
        if self._flocking_since is not None and not self._over:
            self.flocked = now - self._flocking_since
            self._over = not flock.flocking
        slot = math.floor(now / self._scenario.sample_period + 1e-6)
        if slot <= self._slot:
            return
        row = self._look(flock)
        # After a late tick the row is repeated, so that the log has no gap.
        for number in range(self._slot + 1, slot + 1):
            self._rows.append((np.int64(number * round(self._scenario.sample_period * 1e9)), *row))  # type: ignore[arg-type]
        self._slot = slot
        if len(self._rows) >= _BLOCK:
            self._write()

    def figures(self, flock: Controller) -> Figures:
        """Figures of the flight so far."""
        phi = OrderParameters(*self._running.tolist())
        return Figures(
            flocked=self.flocked,
            order_parameters=phi,
            fitness=fitness_of(phi, self._scenario),
            separation_min=self._nearest,
            outside_max=self._outside,
            latency=flock.latency.figures(),
        )

    def finish(self, figures: Figures, error: str | None = None) -> None:
        """End the log with the flight's figures."""
        self._write()
        if self._log is None:
            return
        result = {
            "flown": repr(min(self.flocked, self._scenario.duration)),
            "order_parameters": json.dumps(figures.order_parameters._asdict()),
            "fitness": json.dumps(figures.fitness._asdict()),
            "latency": json.dumps(figures.latency._asdict() if figures.latency else {}),
        }
        self._log.finish(result | ({"error": error} if error else {}))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._log is not None:
            self._write()
            self._log.finish({"flown": repr(self.flocked), "error": str(error) or "the flight was aborted"})

    def _look(self, flock: Controller) -> tuple[NDArray[Any], ...]:
        """Row of the log: qpos, qvel, commands, status, order parameters."""
        drones = len(self._members)
        qpos, qvel = np.empty((drones, 7)), np.zeros((drones, 6))
        for member in self._members:
            i, attitude = member.number, member.vehicle.message("ATTITUDE")
            self._world.position[:, i], self._world.velocity[:, i] = member.position, member.velocity
            qpos[i, :3], qvel[i, :3] = member.position, member.velocity
            qpos[i, 3:] = (1, 0, 0, 0)
            if attitude is not None:
                qpos[i, 3:] = quaternion_of_euler(attitude.roll, -attitude.pitch, math.pi / 2 - attitude.yaw)
                qvel[i, 3:] = frd_of_flu((attitude.rollspeed, attitude.pitchspeed, attitude.yawspeed))
        counts = flock.flocking and self.flocked >= self._scenario.warm_up
        nearest = score(self._world, self._setup.arena, self._setup.ranges, counts, self._accumulator, self._running)
        if counts:
            self._nearest = min(self._nearest, nearest)
            beyond = float(self._arena.distance_outside(self._world.position.T).max())
            self._outside = max(self._outside, beyond)
        return qpos, qvel, flock.desired.T.copy(), self._accumulator.status.copy(), self._running.copy()

    def _write(self) -> None:
        """Write the buffered rows to the log."""
        rows, self._rows = self._rows, []
        if self._log is None or not rows:
            return
        time_ns, qpos, qvel, desired, status, running = (np.stack(column) for column in zip(*rows, strict=True))
        fitness = fitness_of(OrderParameters(*running.T), self._scenario)
        self._log.write(SampleBlock(time_ns, qpos, qvel, desired, status, running, np.stack(fitness, axis=1)))


def _open(path: Path, params: NamedTuple, scenario: Scenario, more: Mapping[str, str]) -> FlightLog:
    step = scenario.step_for("rigid_body")
    metadata = {
        "scenario": scenario.to_toml(),
        "policy": spec_of(params).name,
        "parameters": json.dumps(values_of(params)),
        "dynamics": DEPLOYED,
        "seed": "0",
        "step": repr(step),
        **circumstances(),
        **more,
    }
    return FlightLog(
        path,
        LogHeader(
            metadata=metadata,
            attachments=flight_attachments(scenario, params, step, metadata),
            outline=scenario.arena.outline(),
            altitude=scenario.altitude,
            drones=scenario.drones,
            radius=load_airframe(scenario.airframe).radius,
        ),
    )
