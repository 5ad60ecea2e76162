"""A flock in flight: builds the stages that a scenario asks for, and flies them chunk by chunk."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.policies.interface import Observation, SpeedLimits
from controllers.policies.registry import spec_of
from moflock_mj.dynamics.point_mass import LatePointMass, WindyPointMass, make_point_masses
from moflock_mj.effects.fault_injection import FaultSchedule, make_fault_schedule
from moflock_mj.effects.wind import Wind, make_wind
from moflock_mj.errors import FlightError, LogError, PointError, ScenarioError
from moflock_mj.metrics.order_parameters import MetricAccumulator, MetricRanges
from moflock_mj.metrics.samples import SampleBuffer
from moflock_mj.parameters.points import check_point
from moflock_mj.scenario.scenario import DEFAULT_STEP, Scenario
from moflock_mj.scenario.schedule import Schedule
from moflock_mj.sensing.gps import SensorModel, SensorState
from moflock_mj.simulation.initial_state import make_initial_state
from moflock_mj.simulation.loop import Components, SimulationState, run_intervals
from moflock_mj.simulation.random_numbers import RandomBatch, RandomStreams, draw
from moflock_mj.simulation.snapshot import generator_facts, pack, set_generator, unpack
from moflock_mj.world.square import SquareArena


class Simulation:
    """A flight that has been built and not yet flown to its end.

    Args:
        params: the policy's parameters.
        scenario: what is flown.
        dynamics: "rigid_body" or "point_mass".
        seed: a whole number from 0.

    Raises:
        MoflockError: the scenario cannot be flown with these dynamics.
    """

    def __init__(self, params: NamedTuple, scenario: Scenario, dynamics: str = "rigid_body", seed: int = 1) -> None:
        if dynamics not in DEFAULT_STEP:
            raise ScenarioError(f"dynamics: {dynamics!r} is unknown: it must be one of {', '.join(DEFAULT_STEP)}")
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
            raise ScenarioError(f"seed: {seed!r} is out of bounds: it must be a whole number of at least 0")
        self.params = params = check_point(params)
        self.arena = arena = SquareArena(scenario.arena_side)
        self.scenario = scenario
        self.dynamics = dynamics
        self.seed = int(seed)
        self.step = scenario.step_for(dynamics)
        self.streams = RandomStreams.of(self.seed)
        schedule = Schedule.of(scenario, self.step)
        world = make_initial_state(scenario, self.streams.start)
        self.body = None
        self.wind = make_wind(scenario, schedule.steps_per_interval * self.step, self.streams.wind)
        self.faults = make_fault_schedule(scenario, dynamics, self.step, schedule)
        model: NamedTuple
        if dynamics == "rigid_body":
            from moflock_mj.dynamics.rigid_body import RigidBodyModel  # noqa: PLC0415 - point masses fly without MuJoCo

            self.body = RigidBodyModel(scenario, self.step, schedule.steps_per_interval, world, self.wind, self.faults)
            model = self.body.dynamics
        else:
            model = make_point_masses(scenario, self.step, world, self.wind)
        self.components = Components(
            schedule=schedule,
            dynamics=model,
            params=params,
            limits=SpeedLimits(scenario.v_flock, scenario.v_max, scenario.v_rep_max),
            arena=arena,
            sensors=SensorModel(
                t_gps=scenario.t_gps,
                sigma_inner=scenario.sigma_inner,
                lambda_gps=scenario.lambda_gps,
                r_comm=scenario.r_comm,
                packet_loss=scenario.packet_loss_ratio / scenario.packet_loss_distance**2,
            ),
            faults=self.faults,
            ranges=MetricRanges(spec_of(params).interaction_range(params, scenario.v_flock), scenario.r_coll),
        )
        kept = self.faults.kept if isinstance(self.faults, FaultSchedule) else 0
        self.memory = SimulationState(
            world=world,
            desired=np.zeros((2, scenario.drones)),
            sensor_state=SensorState.at_start(world, schedule.ticks_late + kept),
            observation=Observation.empty(scenario.drones, arena.walls, kept),
            accumulator=MetricAccumulator.empty(scenario.drones, arena.walls),
        )
        self.interval = 0
        """Beats flown so far."""

    @property
    def time(self) -> float:
        """Simulated time flown so far, s."""
        return self.interval * self.components.schedule.steps_per_interval * self.step

    @property
    def samples(self) -> int:
        """Samples taken so far, with that of the start."""
        return self.interval // self.components.schedule.sample_every + 1 if self.interval else 0

    @property
    def finished(self) -> bool:
        return self.interval >= self.components.schedule.intervals

    def run(self, seconds: float, *, whole_states: bool = False) -> SampleBuffer:
        """Fly on for `seconds` of simulated time (at least a beat), or to the flight's end if that is sooner.

        Args:
            seconds: simulated time.
            whole_states: whether the record holds qpos and qvel too.

        Returns:
            The samples that fell due; after the first call, that of the start as well.

        Raises:
            FlightError: a state is no longer finite.
        """
        schedule = self.components.schedule
        wanted = max(round(seconds / (schedule.steps_per_interval * self.step)), 1)
        count = min(wanted, schedule.intervals - self.interval)
        end = self.interval + count
        samples = end // schedule.sample_every - self.interval // schedule.sample_every + (self.interval == 0)
        record = SampleBuffer.empty(samples, samples if whole_states else 0, self.scenario.drones)
        run_intervals(self.components, self.memory, self._draw(count), record, self.interval, count)
        self.interval = end
        if not np.isfinite(self.memory.world.position).all():
            drone = int(np.argmin(np.isfinite(self.memory.world.position).all(axis=0)))
            raise FlightError(f"drone {drone}: its state is no longer finite before {self.time:g} s")
        return record

    def _draw(self, intervals: int) -> RandomBatch:
        """Random numbers for the next beats, the same however a flight is cut into calls."""
        schedule = self.components.schedule
        ticks = -(-(self.interval + intervals) // schedule.sense_every) - -(-self.interval // schedule.sense_every)
        steps = intervals * schedule.steps_per_interval
        return draw(self.streams, self.scenario, self.dynamics, ticks=ticks, intervals=intervals, steps=steps)

    def set_parameters(self, params: NamedTuple) -> None:
        """Fly on with other parameters of the same policy, from the next time that the drones decide.

        Raises:
            PointError: they are not valid, or of another policy.
        """
        params = check_point(params)
        if type(params) is not type(self.params):
            raise PointError(
                f"policy: {spec_of(params).name!r} is another than the flight's, {spec_of(self.params).name!r}"
            )
        ranges = self.components.ranges._replace(
            r_cluster=spec_of(params).interaction_range(params, self.scenario.v_flock)
        )
        self.params = params
        self.components = self.components._replace(params=params, ranges=ranges)

    @property
    def touched_with(self) -> NDArray[np.int64] | None:
        """(N,), what each drone that touched something has touched; None for point masses without faults.

        Point masses touch nothing but the ground, when they are switched off.
        """
        if self.body:
            return self.body.dynamics.statistics.touch_with
        return np.full(self.scenario.drones, -1) if self.scenario.faults else None

    def snapshot(self) -> bytes:
        """The whole state, from which `restore` goes on bit by bit."""
        facts = {name: generator_facts(rng) for name, rng in self.streams._asdict().items()}
        return pack(self._arrays(), {"beat": self.interval, "streams": facts})

    def restore(self, snapshot: bytes) -> None:
        """Go to a state that a flock of the same scenario and dynamics was in.

        Raises:
            LogError: not a snapshot of such a flock.
        """
        stored, facts = unpack(snapshot)
        arrays = self._arrays()
        if {n: (a.dtype, a.shape) for n, a in stored.items()} != {n: (a.dtype, a.shape) for n, a in arrays.items()}:
            raise LogError("state: of another scenario or other dynamics")
        interval, streams = facts.get("beat"), facts.get("streams")
        if (
            not isinstance(interval, int)
            or not 0 <= interval <= self.components.schedule.intervals
            or not isinstance(streams, dict)
        ):
            raise LogError("state: not a snapshot of a flight")
        for name, rng in self.streams._asdict().items():
            set_generator(rng, streams.get(name))
        for name, array in arrays.items():
            array[...] = stored[name]
        if self.body:
            self.body.load_mujoco(stored["mujoco"])
        self.interval = interval

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """Every array that changes in flight, by name, but for what is sensed anew before it is used."""
        memory = self.memory
        rooms: dict[str, Any] = {
            "world": memory.world,
            "sensor": memory.sensor_state,
            "tally": memory.accumulator,
        }
        if isinstance(self.wind, Wind):
            rooms["wind"] = self.wind
        model = self.components.dynamics
        if isinstance(model, LatePointMass):
            rooms["delay"], model = model, model.response
        if isinstance(model, WindyPointMass):
            rooms["point_mass"] = model
        if isinstance(self.faults, FaultSchedule):
            rooms["faults"] = self.faults.memory
        named = {
            f"{room}.{name}": array
            for room, held in rooms.items()
            for name, array in held._asdict().items()
            if isinstance(array, np.ndarray)
        }
        return named | {"desired": memory.desired} | (self.body.arrays() if self.body else {})
