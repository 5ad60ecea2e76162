"""Lock-step of N autopilots and one MuJoCo simulation, which steps when every autopilot has sent its outputs.

An autopilot that is silent for `PATIENCE` is dropped: its rotors stop, and the others continue. It continues when it
sends again.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from collections.abc import Callable

import numpy as np

from controllers.airframe import ROTORS
from moflock_mj.errors import FleetError, FlightError
from moflock_mj.mavlink.frames import Origin
from moflock_mj.scenario.effect_configs import ImuConfig
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulation.initial_state import grid
from moflock_mj.simulation.random_numbers import RandomStreams
from moflock_mj.simulation.realtime_bodies import RealtimeBodies
from moflock_mj.sitl import ardupilot_json, px4_hil
from moflock_mj.sitl.interface import STILL, AutopilotInterface, Reading
from moflock_mj.sitl.motors import CURVE, Motors
from moflock_mj.sitl.sensors import SimulatedSensors

PATIENCE = 5.0
"""Wall time for which the simulation waits for one autopilot, s."""

VEHICLES_MAX = 250
_SPEED_MAX = 100.0
_LATE_MAX = 0.5
"""Seconds the loop may lag before it stops catching up."""
_STOP_POLL = 0.1
"""Interval of the check whether to stop while waiting for an autopilot, s."""
_ABSENT_POLL = 0.1
"""Interval of the check for a dropped autopilot, s of simulated time."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Interface:
    """Interface of the physics to one kind of autopilot.

    Attributes:
        link: factory of the link of a drone.
        base_port: port of the first instance.
        port_step: difference between the ports of two instances.
        rate: rate of exchanges, Hz.
        substeps: number of integration steps in one exchange.
    """

    link: Callable[[int], AutopilotInterface]
    base_port: int
    port_step: int
    rate: int
    substeps: int


INTERFACES = {
    "ardupilot": Interface(
        link=ardupilot_json.ArduPilotLink,
        base_port=ardupilot_json.BASE_PORT,
        port_step=ardupilot_json.PORT_STEP,
        rate=ardupilot_json.RATE,
        substeps=1,
    ),
    "px4": Interface(
        link=px4_hil.Px4Link,
        base_port=px4_hil.BASE_PORT,
        port_step=1,
        rate=px4_hil.RATE,
        substeps=4,
    ),
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class PhysicsPlan:
    """Plan of the physics for real autopilots.

    Attributes:
        autopilot: name in INTERFACES.
        vehicles: number of vehicles.
        port: port of the first instance; None for the autopilot's default, 0 for any free ports.
        speed: simulated seconds per real second; autopilots may need the same setting.
        spacing: distance between neighbours in the grid on the ground, m.
        patience: time to wait for an autopilot, s; see PATIENCE.
        scenario: scenario with airframe, wind, drag, GPS errors and sensor noise.
        seed: seed of all random numbers.
        origin: geographic position of the world frame's origin.

    Raises:
        FleetError: a value is out of bounds.
    """

    autopilot: str
    vehicles: int = 1
    port: int | None = None
    speed: float = 1.0
    spacing: float = 12.0
    patience: float = PATIENCE
    scenario: Scenario = dataclasses.field(default_factory=Scenario)
    seed: int = 1
    origin: Origin = dataclasses.field(default_factory=Origin)

    def __post_init__(self) -> None:
        if self.autopilot not in INTERFACES:
            raise FleetError(f"physics-for: {self.autopilot!r} is unknown: it must be one of {', '.join(INTERFACES)}")
        reach = self.interface.port_step * (self.vehicles - 1)
        bounds = {
            "vehicles": (1, VEHICLES_MAX),
            "port": (0, 65535 - reach),
            "speed": (0.01, _SPEED_MAX),
            "spacing": (0.01, 1000.0),
            "patience": (0.05, 3600.0),
            "seed": (0, math.inf),
        }
        for name, (low, high) in bounds.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                limits = f"from {low:g} to {high:g}" if math.isfinite(high) else f"at least {low:g}"
                raise FleetError(f"{name}: {value:g} is out of bounds: it must be {limits}")

    @property
    def interface(self) -> Interface:
        """Interface to the autopilots."""
        return INTERFACES[self.autopilot]

    def ports(self) -> list[int]:
        """Port of the physics for each vehicle; 0 for any free port."""
        interface = self.interface
        base = interface.base_port if self.port is None else self.port
        return [base + interface.port_step * number if base else 0 for number in range(self.vehicles)]


class LockStep:
    """The simulation, its autopilots, and the exchange between them.

    Args:
        plan: plan of the simulation.
        notice: callback that receives a line when an autopilot is dropped or returns.
        ended: function that returns the end of an autopilot's program, in words, by the number of its drone; None while
            it runs or is not known.

    Attributes:
        bodies: simulated bodies.
        links: links to the autopilots.
        time: simulated time since all autopilots were connected, s.

    Raises:
        MoflockError: the airframe or the scenario is not suitable.
    """

    def __init__(
        self,
        plan: PhysicsPlan,
        notice: Callable[[str], None] = lambda _line: None,
        ended: Callable[[int], str | None] = lambda _number: None,
    ) -> None:
        self.plan = plan
        interface = plan.interface
        self.period = 1 / interface.rate
        # The scenario's other periods are not used, and are replaced by values that fit the step.
        scenario = plan.scenario.replace(
            step=self.period / interface.substeps, imu=None, drones=plan.vehicles,
            duration=1e6, sample_period=0.1, warm_up=0.0, t_del=0.0,
        )  # fmt: skip
        streams = RandomStreams.of(plan.seed)
        places = grid(plan.vehicles, plan.spacing)
        self._substeps = interface.substeps
        self.bodies = RealtimeBodies(scenario, places, streams, interface.substeps, controlled=False)
        if 2 * self.bodies.radius >= plan.spacing:
            diameter = 2 * self.bodies.radius
            raise FleetError(f"spacing: {plan.spacing:g} m: it must be above the airframe's diameter, {diameter:g} m")
        self._motors = Motors(self.bodies.airframe, CURVE[plan.autopilot])
        self._sensors = SimulatedSensors(
            self.bodies, plan.scenario.imu or ImuConfig(), self.period, plan.origin, streams
        )
        self.links = [interface.link(number) for number in range(plan.vehicles)]
        self._outputs = np.zeros((plan.vehicles, ROTORS))
        self._notice, self._ended = notice, ended
        self._exchanges = 0
        self._last_factor = (0.0, time.perf_counter())

    @property
    def time(self) -> float:
        return self._exchanges * self.period

    def open(self) -> None:
        """Open all links, or none.

        Raises:
            LinkError: a port is in use.
        """
        try:
            for link, port in zip(self.links, self.plan.ports(), strict=True):
                link.open(port)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        for link in self.links:
            link.close()

    def gather(self, stop: Callable[[], bool]) -> bool:
        """Wait until every autopilot has sent outputs; returns False if `stop` returned True before.

        Raises:
            FleetError: an autopilot's program has ended.
        """
        for link in self.links:
            while not link.ready:
                if stop():
                    return False
                link.receive(_STOP_POLL)
                end = None if link.ready else self._ended(link.number)
                if end is not None:
                    raise FleetError(f"autopilot {link.number}: {end}")
            link.present = True
        return True

    def run(self, duration: float = math.inf, stop: Callable[[], bool] = lambda: False) -> None:
        """Run at the plan's speed for `duration` simulated seconds or until `stop` returns True."""
        begun, done = time.perf_counter(), 0
        period = self.period / self.plan.speed
        while not stop() and self.time < duration - self.period / 2:
            if not self.step(stop):
                break
            done += 1
            wait = begun + done * period - time.perf_counter()
            if wait < -_LATE_MAX:
                begun, done = time.perf_counter(), 0
            elif wait > 0:
                time.sleep(wait)

    def step(self, stop: Callable[[], bool] = lambda: False) -> bool:
        """Perform one exchange: receive outputs, advance, send readings; returns False if `stop` returned True.

        Raises:
            FlightError: the state of the bodies is no longer finite.
        """
        if not self._wait_for_outputs(stop):
            return False
        for link in self.links:
            self._outputs[link.number] = link.outputs if link.present else STILL
        self._motors.command(self._outputs, self.bodies.thrust_command)
        self.bodies.advance(self._substeps)
        self._exchanges += 1
        if not math.isfinite(self.bodies.qpos.sum()):
            raise FlightError(f"at {self.time:.3f} s the state is no longer finite: use a smaller step")
        surroundings = functools.cache(self._sensors.surroundings)
        reading = Reading(self.time, self._sensors.motion(), surroundings, self.plan.origin)
        for link in self.links:
            if link.present:
                link.send_reading(reading)
        return True

    def real_time_factor(self) -> float:
        """Simulated over wall time since the previous call, relative to the plan's speed."""
        (before, wall_before), now = self._last_factor, time.perf_counter()
        self._last_factor = (self.time, now)
        return (self.time - before) / max(now - wall_before, 1e-9) / self.plan.speed

    def _wait_for_outputs(self, stop: Callable[[], bool]) -> bool:
        began = None
        for link in self.links:
            if not link.present:
                self._poll_absent(link)
                continue
            link.receive(0.0)
            while not link.ready:
                began = began or time.monotonic()
                reason = self._ended(link.number)
                if reason is None and time.monotonic() - began > self.plan.patience:
                    reason = f"no outputs for {self.plan.patience:g} s"
                if reason is not None:
                    link.present, link.outputs = False, STILL
                    self._notice(f"autopilot {link.number} at {self.time:.1f} s: {reason}; its rotors stop")
                    break
                if stop():
                    return False
                link.receive(min(_STOP_POLL, self.plan.patience))
        return True

    def _poll_absent(self, link: AutopilotInterface) -> None:
        """Check at intervals whether a dropped autopilot sends again."""
        if self._exchanges % round(_ABSENT_POLL / self.period):
            return
        link.receive(0.0)
        if link.ready:
            link.present = True
            self._notice(f"autopilot {link.number} at {self.time:.1f} s: connected again")
