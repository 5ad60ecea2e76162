"""`fly`: one flight from its parameters to its fitness."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from controllers.flocking import FlockingParams
from moflock_mj.events import FlightEvent, fault_events, find_events
from moflock_mj.fitness import Fitness, fitness_of
from moflock_mj.flock import Flock
from moflock_mj.loop import Record
from moflock_mj.motion import MotionFigures, MotionMeter
from moflock_mj.order_parameters import OrderParameters
from moflock_mj.points import check_point
from moflock_mj.scenario import Scenario

_CHUNK = {"point_mass": 10.0, "rigid_body": 5.0}
"""Simulated seconds between two looks at progress and Ctrl-C."""

_FOLLOWED_CHUNK = 1.0
"""Simulated seconds that a log or a live view gets at once, which is also what a killed program loses."""

Progress = Callable[[float, Fitness], None]
"""Told, now and then, the simulated time in s and the running fitness."""


class Follower(Protocol):
    """Something that is told of a flight while it is flown: its log, a live view."""

    @property
    def needs_states(self) -> bool:
        """Whether the next samples are to be flown with whole states."""
        ...

    def store_state(self) -> None:
        """Keep the whole state, if that is due: before the first samples and after each chunk."""
        ...

    def write(self, time_ns: NDArray[np.int64], record: Record, events: list[FlightEvent]) -> None:
        """Take some samples and the events in them."""
        ...

    def finish(self, record: Record) -> None:
        """Take note of the flight's end, at the last of these samples."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Samples(NamedTuple):
    """The flight as it was sampled, T times; true states.

    Attributes:
        t: (T,), s.
        position: (T, N, 3), m, world.
        velocity: (T, N, 3), m/s, world.
        desired_velocity: (T, N, 2), m/s, world, the command in force.
        status: (T, N), flags OUTSIDE, CLOSE and TOUCHED of `order_parameters`.
        nearest: (T,), m, smallest distance between two drones.
        order_parameters: arrays over (T,), running.
    """

    t: NDArray[np.float64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    desired_velocity: NDArray[np.float64]
    status: NDArray[np.uint8]
    nearest: NDArray[np.float64]
    order_parameters: OrderParameters


class BodyFigures(NamedTuple):
    """What only a rigid body has.

    Attributes:
        touched: drones that touched another one or the ground.
        lost: drones that have come down: at the end they are below half of the flock's altitude.
        tilt_max: rad, largest tilt of a body.
        altitude_error_max: m.
        saturated_share: share of the drones' time in which a rotor was commanded to its limit.
        energy: J, that all rotors together took.
    """

    touched: int
    lost: int
    tilt_max: float
    altitude_error_max: float
    saturated_share: float
    energy: float


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AnyFlight:
    """What is known of a flight, whether it was flown just now or is read from its log.

    Attributes:
        params: the policy's parameters.
        scenario: what was flown.
        dynamics: "rigid_body" or "point_mass", or "deployed" for vehicles over MAVLink.
        seed: of all random numbers.
        flown: s, simulated, or of a deployed flight in the flock; less than the scenario's duration if the flight
            was stopped.
        order_parameters: over the flight.
        fitness: of them.
        samples: the flight; None if they were not kept.
        events: touches, near misses, breaches, faults, in order of time.
        log: where it is logged, or None.
    """

    params: FlockingParams
    scenario: Scenario
    dynamics: str
    seed: int
    flown: float
    order_parameters: OrderParameters
    fitness: Fitness
    samples: Samples | None
    events: tuple[FlightEvent, ...]
    log: Path | None

    @property
    def flock_name(self) -> str:
        """What flew, and how many."""
        kinds = {"rigid_body": f"{self.scenario.airframe} rigid bodies", "point_mass": "point masses"}
        return f"{self.scenario.drones} {kinds.get(self.dynamics, 'vehicles over MAVLink')}"

    @property
    def complete(self) -> bool:
        """Whether the flight lasted as long as its scenario."""
        return self.flown >= self.scenario.duration - 1e-9


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Flight(AnyFlight):
    """A flight that is over.

    Attributes:
        motion: how well it was flown.
        body: what only rigid bodies have; None for point masses.
        wall_seconds: how long it took.
    """

    motion: MotionFigures
    body: BodyFigures | None
    wall_seconds: float


def fly(
    params: FlockingParams,
    *,
    scenario: Scenario | None = None,
    dynamics: str = "rigid_body",
    seed: int = 1,
    log: str | Path | None = None,
    keep_samples: bool = True,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
    followers: Sequence[Callable[[Flock], Follower]] = (),
) -> Flight:
    """Fly a flock.

    Args:
        params: the policy's 12 parameters.
        scenario: what is flown; the paper's if absent.
        dynamics: "rigid_body" (MuJoCo) or "point_mass".
        seed: a whole number from 0; the same seed gives the same flight.
        log: an MCAP file to be written, or None.
        keep_samples: whether the flight keeps its samples; an optimiser needs none.
        progress: told how far the flight is.
        stop: asked now and then; the flight ends, with a finished log, when it says True.
        followers: others, made from the flock, that are told of the flight while it is flown.

    Raises:
        MoflockError: what was asked for cannot be flown, a state is no longer finite, or the log cannot be written.
    """
    flock = Flock(check_point(params), scenario or Scenario(), dynamics, seed)
    return fly_on(flock, log=log, keep_samples=keep_samples, progress=progress, stop=stop, followers=followers)


def fly_on(
    flock: Flock,
    *,
    log: str | Path | None = None,
    origin: Mapping[str, str] | None = None,
    keep_samples: bool = True,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
    followers: Sequence[Callable[[Flock], Follower]] = (),
) -> Flight:
    """Fly a flock that stands at its start, or at a state that it was put into, to the end of its scenario.

    Args:
        flock: flies; must not be at its end.
        log: as for `fly`.
        origin: what the log's metadata say of where the flock's state comes from.
        keep_samples: as for `fly`, and so are the other three.
        progress: told how far the flight is.
        stop: ends the flight.
        followers: told of the flight.
    """
    began, scenario = time.perf_counter(), flock.scenario
    records: list[Record] = []
    events: list[FlightEvent] = []
    before, first = flock.memory.tally.status.copy(), flock.samples
    meter = MotionMeter(scenario, started=first > 0)
    period, told_ns = flock.stages.clocks.steps_per_beat * flock.step, round(flock.time * 1e9) if first else -1
    with contextlib.ExitStack() as resources:
        if log is not None:
            from moflock_mj.flight_log import FlightLogger  # noqa: PLC0415 - the log's libraries load only for a log

            followers = [lambda flown: FlightLogger(log, flown, origin or {}), *followers]
        told = [resources.enter_context(make(flock)) for make in followers]
        chunk = _FOLLOWED_CHUNK if told else _CHUNK[flock.dynamics]
        for follower in told:
            follower.store_state()
        while not flock.finished and not (records and stop is not None and stop()):
            number = flock.samples
            record = flock.fly(chunk, whole_states=any(follower.needs_states for follower in told))
            if not len(record.nearest):
                continue  # the samples are farther apart than a chunk is long
            time_ns = sample_times(scenario, number, len(record.nearest))
            found = find_events(record, before, time_ns, flock.touched_with)
            found += fault_events(scenario, period, told_ns, int(time_ns[-1]))
            found.sort(key=lambda event: event.time_ns)
            before, told_ns = record.status[-1], int(time_ns[-1])
            events += found
            meter.add(record)
            for follower in told:
                follower.write(time_ns, record, found)
                follower.store_state()
            if progress:
                progress(flock.time, final_fitness(record, scenario))
            records = [*records, record] if keep_samples else [record]
        for follower in told:
            follower.finish(records[-1])
    return Flight(
        params=flock.params,
        scenario=scenario,
        dynamics=flock.dynamics,
        seed=flock.seed,
        flown=flock.time,
        order_parameters=final_order_parameters(records[-1]),
        fitness=final_fitness(records[-1], scenario),
        samples=join_samples(records, scenario, first) if keep_samples else None,
        events=tuple(events),
        motion=meter.figures(),
        body=_body_figures(flock),
        wall_seconds=time.perf_counter() - began,
        log=Path(log) if log is not None else None,
    )


def sample_times(scenario: Scenario, first: int, count: int) -> NDArray[np.int64]:
    """Simulated times of `count` samples from number `first`, ns."""
    numbers = np.arange(first, first + count)
    return (numbers * round(scenario.sample_period * 1e9)).astype(np.int64)


def final_order_parameters(record: Record) -> OrderParameters:
    """The order parameters up to a record's last sample."""
    return OrderParameters(*record.order_parameters[-1].tolist())


def final_fitness(record: Record, scenario: Scenario) -> Fitness:
    """The fitness up to a record's last sample."""
    return fitness_of(final_order_parameters(record), scenario)


def join_samples(records: list[Record], scenario: Scenario, first: int) -> Samples:
    """The samples of consecutive records, counted from number `first`."""
    joined = {
        name: np.concatenate([getattr(record, name) for record in records])
        for name in ("position", "velocity", "desired", "status", "nearest", "order_parameters")
    }
    return Samples(
        t=np.asarray(sample_times(scenario, first, len(joined["nearest"])) / 1e9, np.float64),
        position=joined["position"],
        velocity=joined["velocity"],
        desired_velocity=joined["desired"].swapaxes(1, 2),
        status=joined["status"],
        nearest=joined["nearest"],
        order_parameters=OrderParameters(*joined["order_parameters"].T),
    )


def _body_figures(flock: Flock) -> BodyFigures | None:
    if flock.body is None:
        return None
    extremes = flock.body.plant.extremes
    drone_steps = extremes.saturated.size * max(int(extremes.steps[0]), 1)
    return BodyFigures(
        touched=int(np.sum(extremes.touch_step >= 0)),
        lost=int(np.sum(flock.body.plant.qpos[:, 2] < flock.scenario.altitude / 2)),
        tilt_max=float(np.arccos(np.clip(extremes.upright.min(), -1, 1))),
        altitude_error_max=float(extremes.altitude_error.max()),
        saturated_share=float(extremes.saturated.sum() / drone_steps),
        energy=float(extremes.energy.sum()),
    )
