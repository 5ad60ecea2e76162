"""Flights from parameters to fitness: `fly`, `fly_many` and `continue_flight`."""

from __future__ import annotations

import concurrent.futures
import contextlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from moflock_mj.metrics.events import FlightEvent, fault_events, find_events
from moflock_mj.metrics.samples import SampleBuffer, final_fitness, final_order_parameters, join_samples, sample_times
from moflock_mj.metrics.tracking import MotionMeter
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulation.results import BodyFigures, Flight, FlightObserver, Progress
from moflock_mj.simulation.simulation import Simulation

_CHUNK = {"point_mass": 10.0, "rigid_body": 5.0}
"""Simulated seconds between two checks of progress and Ctrl-C."""

_FOLLOWED_CHUNK = 1.0
"""Simulated seconds per record of a log or a live view. A killed program loses at most one record."""


def fly(
    params: NamedTuple,
    *,
    scenario: Scenario | None = None,
    dynamics: str = "rigid_body",
    seed: int = 1,
    log: str | Path | None = None,
    keep_samples: bool = True,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
    observers: Sequence[Callable[[Simulation], FlightObserver]] = (),
) -> Flight:
    """Fly a flock.

    Args:
        params: parameters of the policy.
        scenario: scenario of the flight; the paper's if absent.
        dynamics: "rigid_body" (MuJoCo) or "point_mass".
        seed: whole number from 0; equal seeds give equal flights.
        log: path of an MCAP file to write, or None.
        keep_samples: True to keep the samples of the flight; an optimiser does not need them.
        progress: callback with the simulated time and the fitness so far.
        stop: function that is polled after each record; if True, the flight ends early with a complete log.
        observers: constructors, from the simulation, of further observers of the running flight.

    Raises:
        MoflockError: the flight is not possible, a state is no longer finite, or the log cannot be written.
    """
    simulation = Simulation(params, scenario or Scenario(), dynamics, seed)
    return continue_flight(
        simulation, log=log, keep_samples=keep_samples, progress=progress, stop=stop, observers=observers
    )


def fly_many(
    params: Sequence[NamedTuple],
    *,
    scenario: Scenario | None = None,
    dynamics: str = "rigid_body",
    seeds: Sequence[int] = (1,),
    workers: int | None = None,
    keep_samples: bool = False,
) -> list[list[Flight]]:
    """Fly several parameter sets, each with several seeds, in parallel threads (compiled flights release the GIL).

    Args:
        params: P parameter sets.
        scenario: scenario of the flights; the paper's if absent.
        dynamics: "rigid_body" or "point_mass".
        seeds: S seeds, the same for each set.
        workers: number of threads; by default the number of processors.
        keep_samples: True to keep the samples of the flights.

    Returns:
        (P, S) flights, in the order of the sets and the seeds.

    Raises:
        MoflockError: one of the flights fails, see `fly`.
    """

    def one(task: tuple[NamedTuple, int]) -> Flight:
        point, seed = task
        return fly(point, scenario=scenario, dynamics=dynamics, seed=seed, keep_samples=keep_samples)

    tasks = [(point, seed) for point in params for seed in seeds]
    with concurrent.futures.ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        flights = list(pool.map(one, tasks))
    return [flights[first : first + len(seeds)] for first in range(0, len(flights), len(seeds))]


def continue_flight(
    simulation: Simulation,
    *,
    log: str | Path | None = None,
    origin: Mapping[str, str] | None = None,
    keep_samples: bool = True,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
    observers: Sequence[Callable[[Simulation], FlightObserver]] = (),
) -> Flight:
    """Run a simulation from its present state, initial or restored, to the end of its scenario.

    Args:
        simulation: the simulation; it must not be finished.
        log: see `fly`.
        origin: log metadata about the source of the initial state.
        keep_samples: see `fly`.
        progress: see `fly`.
        stop: see `fly`.
        observers: see `fly`.
    """
    start_time, scenario = time.perf_counter(), simulation.scenario
    records: list[SampleBuffer] = []
    events: list[FlightEvent] = []
    before, first = simulation.memory.accumulator.status.copy(), simulation.samples
    meter = MotionMeter(scenario, started=first > 0)
    period = simulation.components.schedule.steps_per_interval * simulation.step
    reported_ns = round(simulation.time * 1e9) if first else -1
    with contextlib.ExitStack() as resources:
        if log is not None:
            from moflock_mj.log.flight_logger import FlightLogger  # noqa: PLC0415 - the log's libraries are slow to import

            observers = [lambda running: FlightLogger(log, running, origin or {}), *observers]
        following = [resources.enter_context(make(simulation)) for make in observers]
        chunk = _FOLLOWED_CHUNK if following else _CHUNK[simulation.dynamics]
        for observer in following:
            observer.store_state()
        while not simulation.finished and not (records and stop is not None and stop()):
            number = simulation.samples
            record = simulation.run(chunk, whole_states=any(observer.needs_states for observer in following))
            if not len(record.nearest):
                continue  # the sample period is longer than a chunk
            time_ns = sample_times(scenario, number, len(record.nearest))
            found = find_events(record, before, time_ns, simulation.touched_with)
            found += fault_events(scenario, period, reported_ns, int(time_ns[-1]))
            found.sort(key=lambda event: event.time_ns)
            before, reported_ns = record.status[-1], int(time_ns[-1])
            events += found
            meter.add(record)
            for observer in following:
                observer.write(time_ns, record, found)
                observer.store_state()
            if progress:
                progress(simulation.time, final_fitness(record, scenario))
            records = [*records, record] if keep_samples else [record]
        for observer in following:
            observer.finish(records[-1])
    return Flight(
        params=simulation.params,
        scenario=scenario,
        dynamics=simulation.dynamics,
        seed=simulation.seed,
        flown=simulation.time,
        order_parameters=final_order_parameters(records[-1]),
        fitness=final_fitness(records[-1], scenario),
        samples=join_samples(records, scenario, first) if keep_samples else None,
        events=tuple(events),
        motion=meter.figures(),
        body=_body_figures(simulation),
        wall_seconds=time.perf_counter() - start_time,
        log=Path(log) if log is not None else None,
    )


def _body_figures(simulation: Simulation) -> BodyFigures | None:
    if simulation.body is None:
        return None
    statistics = simulation.body.dynamics.statistics
    drone_steps = statistics.saturated.size * max(int(statistics.steps[0]), 1)
    return BodyFigures(
        touched=int(np.sum(statistics.touch_step >= 0)),
        lost=int(np.sum(simulation.body.dynamics.state.qpos[:, 2] < simulation.scenario.altitude / 2)),
        tilt_max=float(np.arccos(np.clip(statistics.upright.min(), -1, 1))),
        altitude_error_max=float(statistics.altitude_error.max()),
        saturated_share=float(statistics.saturated.sum() / drone_steps),
        energy=float(statistics.energy.sum()),
    )
