"""Simulation of a flock: construction from a scenario, and execution in chunks."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.policies.interface import Observation
from controllers.policies.registry import spec_of
from moflock_mj.dynamics.point_mass import make_point_masses
from moflock_mj.effects.fault_injection import FaultSchedule, make_fault_schedule
from moflock_mj.effects.wind import make_wind
from moflock_mj.errors import FlightError, LogError, PointError, ScenarioError
from moflock_mj.metrics.order_parameters import MetricAccumulator
from moflock_mj.metrics.samples import SampleBuffer
from moflock_mj.scenario.scenario import DEFAULT_STEP, Scenario
from moflock_mj.scenario.schedule import Schedule
from moflock_mj.sensing.gps import SensorState
from moflock_mj.simulation.initial_state import make_initial_state
from moflock_mj.simulation.loop import Components, SimulationState, run_intervals
from moflock_mj.simulation.random_numbers import RandomBatch, RandomStreams, draw
from moflock_mj.simulation.setup import FlightSetup
from moflock_mj.simulation.snapshot import arrays_of, generator_facts, pack, set_generator, unpack

_MUJOCO = "mujoco"
"""Name of MuJoCo's own state in a snapshot."""


class Simulation:
    """Simulation of one flight.

    Args:
        params: parameters of the policy.
        scenario: scenario of the flight.
        dynamics: "rigid_body" or "point_mass".
        seed: whole number from 0.

    Raises:
        MoflockError: the scenario is not possible with these dynamics.
    """

    def __init__(self, params: NamedTuple, scenario: Scenario, dynamics: str = "rigid_body", seed: int = 1) -> None:
        if dynamics not in DEFAULT_STEP:
            raise ScenarioError(f"dynamics: {dynamics!r} is unknown: it must be one of {', '.join(DEFAULT_STEP)}")
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
            raise ScenarioError(f"seed: {seed!r} is out of bounds: it must be a whole number of at least 0")
        setup = FlightSetup.resolve(params, scenario)
        self.params = setup.params
        self.arena = arena = scenario.arena
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
            from moflock_mj.dynamics.rigid_body import RigidBodyModel  # noqa: PLC0415 - point masses do not need MuJoCo

            self.body = RigidBodyModel(scenario, self.step, schedule.steps_per_interval, world, self.wind, self.faults)
            model = self.body.dynamics
        else:
            model = make_point_masses(scenario, self.step, world, self.wind)
        self.components = Components(
            schedule=schedule,
            dynamics=model,
            params=setup.params,
            limits=setup.limits,
            arena=setup.arena,
            sensors=setup.sensors,
            faults=self.faults,
            ranges=setup.ranges,
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
        """Number of completed control intervals."""

    @property
    def time(self) -> float:
        """Simulated time so far, s."""
        return self.interval * self.components.schedule.steps_per_interval * self.step

    @property
    def samples(self) -> int:
        """Number of samples so far, including the initial one."""
        return self.interval // self.components.schedule.sample_every + 1 if self.interval else 0

    @property
    def finished(self) -> bool:
        """True at the end of the scenario."""
        return self.interval >= self.components.schedule.intervals

    def run(self, seconds: float, *, whole_states: bool = False) -> SampleBuffer:
        """Run for `seconds` of simulated time (at least one interval), or to the end of the flight.

        Args:
            seconds: simulated time, s.
            whole_states: True to include qpos and qvel in the record.

        Returns:
            The samples of this time; those of the first call include the initial sample.

        Raises:
            FlightError: a state is no longer finite.
        """
        schedule = self.components.schedule
        requested = max(round(seconds / (schedule.steps_per_interval * self.step)), 1)
        count = min(requested, schedule.intervals - self.interval)
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
        """Draw the random numbers of the next intervals."""
        schedule = self.components.schedule
        ticks = -(-(self.interval + intervals) // schedule.sense_every) - -(-self.interval // schedule.sense_every)
        steps = intervals * schedule.steps_per_interval
        return draw(self.streams, self.scenario, self.dynamics, ticks=ticks, intervals=intervals, steps=steps)

    def set_parameters(self, params: NamedTuple) -> None:
        """Change the parameters, within the same policy, from the next fix on.

        Raises:
            PointError: the parameters are not valid, or of another policy.
        """
        setup = FlightSetup.resolve(params, self.scenario)
        if type(setup.params) is not type(self.params):
            raise PointError(
                f"policy: {spec_of(params).name!r} is not that of the flight: it must be {spec_of(self.params).name!r}"
            )
        self.params = setup.params
        self.components = self.components._replace(params=setup.params, ranges=setup.ranges)

    @property
    def touched_with(self) -> NDArray[np.int64] | None:
        """(N,), number of the drone in the first contact of each drone, -1 for the ground or without contact.

        The array is None for point masses without faults. Point masses touch only the ground, after power_off.
        """
        if self.body:
            return self.body.dynamics.statistics.touch_with
        return np.full(self.scenario.drones, -1) if self.scenario.faults else None

    def snapshot(self) -> bytes:
        """Complete state, from which `restore` continues bit-identically."""
        facts = {name: generator_facts(rng) for name, rng in self.streams._asdict().items()}
        arrays = self._arrays()
        if self.body:
            arrays[_MUJOCO] = self.body.mujoco_state()
        return pack(arrays, {"interval": self.interval, "streams": facts})

    def restore(self, snapshot: bytes) -> None:
        """Restore a state of a simulation with the same scenario and dynamics.

        Raises:
            LogError: not a snapshot of such a simulation.
        """
        stored, facts = unpack(snapshot)
        arrays = self._arrays()
        if self.body:
            arrays[_MUJOCO] = self.body.mujoco_state()
        if {n: (a.dtype, a.shape) for n, a in stored.items()} != {n: (a.dtype, a.shape) for n, a in arrays.items()}:
            raise LogError("state: of another scenario or other dynamics")
        interval, streams = facts.get("interval"), facts.get("streams")
        last = self.components.schedule.intervals
        if not isinstance(interval, int) or not 0 <= interval <= last or not isinstance(streams, dict):
            raise LogError("state: not a snapshot of a flight")
        for name, rng in self.streams._asdict().items():
            set_generator(rng, streams.get(name))
        for name, array in arrays.items():
            array[...] = stored[name]
        if self.body:
            self.body.load_mujoco(stored[_MUJOCO])
        self.interval = interval

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """All arrays that change in flight, except the observation, which is recomputed before its next use."""
        kept = self.memory._replace(observation=Observation.empty(0, 0))
        return arrays_of({"flight": kept, "dynamics": self.components.dynamics, "faults": self.faults})
