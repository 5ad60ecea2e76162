"""A flock in flight: builds the stages that a scenario asks for, and flies them chunk by chunk."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.policies.interface import Sensed, SpeedLimits
from controllers.policies.vasarhelyi import FlockingParams
from moflock_mj.dynamics.point_mass import LatePointMass, WindyPointMass, make_point_masses
from moflock_mj.effects.fault_injection import Breakdown, make_breakdown
from moflock_mj.effects.wind import Wind, make_wind
from moflock_mj.errors import FlightError, LogError, ScenarioError
from moflock_mj.metrics.order_parameters import Tally, Yardstick, cluster_range
from moflock_mj.metrics.samples import Record
from moflock_mj.scenario.scenario import DEFAULT_STEP, Scenario
from moflock_mj.scenario.schedule import Clocks
from moflock_mj.sensing.gps import SensorModel, SensorState
from moflock_mj.simulation.initial_state import start_world
from moflock_mj.simulation.loop import Memory, Stages, fly_beats
from moflock_mj.simulation.random_numbers import Draws, Streams, draw
from moflock_mj.simulation.snapshot import generator_facts, pack, set_generator, unpack
from moflock_mj.world.square import SquareArena


class Flock:
    """A flight that has been built and not yet flown to its end.

    Args:
        params: the policy's parameters.
        scenario: what is flown.
        dynamics: "rigid_body" or "point_mass".
        seed: a whole number from 0.

    Raises:
        MoflockError: the scenario cannot be flown with these dynamics.
    """

    def __init__(self, params: FlockingParams, scenario: Scenario, dynamics: str, seed: int) -> None:
        if dynamics not in DEFAULT_STEP:
            raise ScenarioError(f"dynamics: {dynamics!r} is unknown: it must be one of {', '.join(DEFAULT_STEP)}")
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
            raise ScenarioError(f"seed: {seed!r} is out of bounds: it must be a whole number of at least 0")
        self.params = params
        self.arena = arena = SquareArena(scenario.arena_side)
        self.scenario = scenario
        self.dynamics = dynamics
        self.seed = int(seed)
        self.step = scenario.step_for(dynamics)
        self.streams = Streams.of(self.seed)
        clocks = Clocks.of(scenario, self.step)
        world = start_world(scenario, self.streams.start)
        self.body = None
        self.wind = make_wind(scenario, clocks.steps_per_beat * self.step, self.streams.wind)
        self.faults = make_breakdown(scenario, dynamics, self.step, clocks)
        plant: NamedTuple
        if dynamics == "rigid_body":
            from moflock_mj.dynamics.rigid_body import RigidBodyFlock  # noqa: PLC0415 - point masses fly without MuJoCo

            self.body = RigidBodyFlock(scenario, self.step, clocks.steps_per_beat, world, self.wind, self.faults)
            plant = self.body.plant
        else:
            plant = make_point_masses(scenario, self.step, world, self.wind)
        self.stages = Stages(
            clocks=clocks,
            plant=plant,
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
            yardstick=Yardstick(cluster_range(params, scenario.v_flock), scenario.r_coll),
        )
        kept = self.faults.kept if isinstance(self.faults, Breakdown) else 0
        self.memory = Memory(
            world=world,
            desired=np.zeros((2, scenario.drones)),
            sensor_state=SensorState.at_start(world, clocks.ticks_late + kept),
            sensed=Sensed.empty(scenario.drones, arena.walls, kept),
            tally=Tally.empty(scenario.drones, arena.walls),
        )
        self.beat = 0
        """Beats flown so far."""

    @property
    def time(self) -> float:
        """Simulated time flown so far, s."""
        return self.beat * self.stages.clocks.steps_per_beat * self.step

    @property
    def samples(self) -> int:
        """Samples taken so far, with that of the start."""
        return self.beat // self.stages.clocks.sample_every + 1 if self.beat else 0

    @property
    def finished(self) -> bool:
        return self.beat >= self.stages.clocks.beats

    def fly(self, seconds: float, *, whole_states: bool = False) -> Record:
        """Fly on for `seconds` of simulated time (at least a beat), or to the flight's end if that is sooner.

        Args:
            seconds: simulated time.
            whole_states: whether the record holds qpos and qvel too.

        Returns:
            The samples that fell due; after the first call, that of the start as well.

        Raises:
            FlightError: a state is no longer finite.
        """
        clocks = self.stages.clocks
        wanted = max(round(seconds / (clocks.steps_per_beat * self.step)), 1)
        count = min(wanted, clocks.beats - self.beat)
        end = self.beat + count
        samples = end // clocks.sample_every - self.beat // clocks.sample_every + (self.beat == 0)
        record = Record.empty(samples, samples if whole_states else 0, self.scenario.drones)
        fly_beats(self.stages, self.memory, self._draw(count), record, self.beat, count)
        self.beat = end
        if not np.isfinite(self.memory.world.position).all():
            drone = int(np.argmin(np.isfinite(self.memory.world.position).all(axis=0)))
            raise FlightError(f"drone {drone}: its state is no longer finite before {self.time:g} s")
        return record

    def _draw(self, beats: int) -> Draws:
        """Random numbers for the next beats, the same however a flight is cut into calls."""
        clocks = self.stages.clocks
        ticks = -(-(self.beat + beats) // clocks.sense_every) - -(-self.beat // clocks.sense_every)
        steps = beats * clocks.steps_per_beat
        return draw(self.streams, self.scenario, self.dynamics, ticks=ticks, beats=beats, steps=steps)

    @property
    def touched_with(self) -> NDArray[np.int64] | None:
        """(N,), what each drone that touched something has touched; None for point masses without faults.

        Point masses touch nothing but the ground, when they are switched off.
        """
        if self.body:
            return self.body.plant.extremes.touch_with
        return np.full(self.scenario.drones, -1) if self.scenario.faults else None

    def snapshot(self) -> bytes:
        """The whole state, from which `restore` goes on bit by bit."""
        facts = {name: generator_facts(rng) for name, rng in self.streams._asdict().items()}
        return pack(self._arrays(), {"beat": self.beat, "streams": facts})

    def restore(self, snapshot: bytes) -> None:
        """Go to a state that a flock of the same scenario and dynamics was in.

        Raises:
            LogError: not a snapshot of such a flock.
        """
        stored, facts = unpack(snapshot)
        arrays = self._arrays()
        if {n: (a.dtype, a.shape) for n, a in stored.items()} != {n: (a.dtype, a.shape) for n, a in arrays.items()}:
            raise LogError("state: of another scenario or other dynamics")
        beat, streams = facts.get("beat"), facts.get("streams")
        if not isinstance(beat, int) or not 0 <= beat <= self.stages.clocks.beats or not isinstance(streams, dict):
            raise LogError("state: not a snapshot of a flight")
        for name, rng in self.streams._asdict().items():
            set_generator(rng, streams.get(name))
        for name, array in arrays.items():
            array[...] = stored[name]
        if self.body:
            self.body.load_mujoco(stored["mujoco"])
        self.beat = beat

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """Every array that changes in flight, by name, but for what is sensed anew before it is used."""
        memory = self.memory
        rooms: dict[str, Any] = {
            "world": memory.world,
            "sensor": memory.sensor_state,
            "tally": memory.tally,
        }
        if isinstance(self.wind, Wind):
            rooms["wind"] = self.wind
        plant = self.stages.plant
        if isinstance(plant, LatePointMass):
            rooms["delay"], plant = plant, plant.response
        if isinstance(plant, WindyPointMass):
            rooms["point_mass"] = plant
        if isinstance(self.faults, Breakdown):
            rooms["faults"] = self.faults.memory
        named = {
            f"{room}.{name}": array
            for room, held in rooms.items()
            for name, array in held._asdict().items()
            if isinstance(array, np.ndarray)
        }
        return named | {"desired": memory.desired} | (self.body.arrays() if self.body else {})
