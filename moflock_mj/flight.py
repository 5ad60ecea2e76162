"""`fly`: one flight from its parameters to its fitness."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from controllers.policies.vasarhelyi import FlockingParams
from moflock_mj.metrics.events import FlightEvent, fault_events, find_events
from moflock_mj.metrics.samples import Record, final_fitness, final_order_parameters, join_samples, sample_times
from moflock_mj.metrics.tracking import MotionMeter
from moflock_mj.parameters.points import check_point
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulation.results import BodyFigures, Flight, Follower, Progress
from moflock_mj.simulation.simulation import Flock

_CHUNK = {"point_mass": 10.0, "rigid_body": 5.0}
"""Simulated seconds between two looks at progress and Ctrl-C."""


_FOLLOWED_CHUNK = 1.0
"""Simulated seconds that a log or a live view gets at once, which is also what a killed program loses."""


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
            from moflock_mj.log.flight_logger import FlightLogger  # noqa: PLC0415 - the log's libraries load only for a log

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
