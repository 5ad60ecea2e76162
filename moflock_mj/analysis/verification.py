"""Verification of a log by repeating its flight, and resumption of a flight from a logged state."""

from __future__ import annotations

import bisect
import dataclasses
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.policies.registry import spec_of
from controllers.policies.target_tracking import TargetTrackingParams
from moflock_mj.errors import LogError, PointError
from moflock_mj.flight import continue_flight
from moflock_mj.log.flight_logger import run_metadata
from moflock_mj.log.reader import LoggedFlight
from moflock_mj.log.schemas import RESUMED_AT, RESUMED_FROM, state_digests
from moflock_mj.metrics.samples import SampleBuffer, final_fitness, sample_times
from moflock_mj.parameters.points import check_point
from moflock_mj.scenario.scenario import DEPLOYED, Scenario
from moflock_mj.simulation.results import Flight, Progress
from moflock_mj.simulation.simulation import Simulation

_CHUNK = 10.0
"""Simulated seconds between two comparisons."""

_VERSIONS = {
    "mujoco_version": "MuJoCo",
    "numpy_version": "NumPy",
    "numba_version": "Numba",
    "cpu": "processor",
    "machine": "machine",
    "moflock_version": "moflock",
    "commit": "moflock's commit",
    "python_version": "Python",
}
"""Metadata that may affect the last bits of a flight, by likelihood, with their labels."""


class VersionChange(NamedTuple):
    """Metadata entry that differs between the log and this machine."""

    name: str
    logged: str
    here: str


class Difference(NamedTuple):
    """First difference between the repeated and the logged flight.

    Attributes:
        tick: number of the sample, from 0 at the start of the flight.
        time: simulated time, s.
        drone: first drone with a different point; None if the difference is below single precision.
        what: kind of the difference: "state", "points" or "order parameters".
    """

    tick: int
    time: float
    drone: int | None
    what: str


@dataclasses.dataclass(frozen=True, kw_only=True)
class Verification:
    """Result of the verification of a log.

    Attributes:
        log: path of the log.
        ticks: number of compared samples, including the first different one.
        start: time of the state from which the flight was repeated, s; 0 unless the logged flight was resumed.
        time: time of the last compared sample, s.
        duration: duration of the log's scenario, s.
        difference: first difference; None if all samples are bit-identical.
        changes: differences of versions and machine, the likely cause of a difference.
        wall_seconds: wall-clock time of the verification, s.
    """

    log: Path
    ticks: int
    start: float
    time: float
    duration: float
    difference: Difference | None
    changes: tuple[VersionChange, ...]
    wall_seconds: float

    @property
    def identical(self) -> bool:
        """True if all samples are bit-identical."""
        return self.difference is None


def verify(logged: LoggedFlight, progress: Progress | None = None) -> Verification:
    """Repeat a logged flight up to the end of its log, and compare digest, points and order parameters of every sample.

    Args:
        logged: flight read from a log.
        progress: callback with the simulated time and the running fitness.

    Raises:
        MoflockError: the flight cannot be repeated.
    """
    start_time = time.perf_counter()
    _refuse_deployed(logged, "verify")
    simulation = _simulation_at_start(logged)
    start, changes = simulation.time, _changes(logged, simulation)
    difference, last = None, float(logged.samples.t[-1])
    while difference is None and not simulation.finished and simulation.time < last - 1e-9:
        number = simulation.samples
        record = simulation.run(min(_CHUNK, last - simulation.time), whole_states=True)
        difference = _first_difference(logged, record, number)
        if progress and len(record.nearest):
            progress(simulation.time, final_fitness(record, logged.scenario))
    compared = difference.time if difference else last
    return Verification(
        log=logged.log,
        ticks=int(np.searchsorted(logged.samples.t, compared, side="right")),
        start=start,
        time=compared,
        duration=logged.scenario.duration,
        difference=difference,
        changes=changes,
        wall_seconds=time.perf_counter() - start_time,
    )


def resume(
    logged: LoggedFlight,
    at: float,
    *,
    params: NamedTuple | None = None,
    duration: float | None = None,
    log: str | Path | None = None,
    keep_samples: bool = True,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
) -> Flight:
    """Resume a logged flight from its latest state up to `at`.

    Without changes, the flight is bit-identical to the original one. Its samples begin after the state, and its order
    parameters continue those of the original flight.

    Args:
        logged: flight read from a log.
        at: simulated time, s.
        params: new parameters, with the same target if there is one; they also determine the distances of the order
            parameters.
        duration: duration after the state, s; to the end of the log's scenario if absent.
        log: path of an MCAP file to write, or None.
        keep_samples: True to keep the samples of the flight.
        progress: callback with the simulated time and the running fitness.
        stop: function that is polled after each record; if True, the flight ends early with a complete log.

    Raises:
        LogError: the log has no state up to `at`.
        MoflockError: the flight is not possible.
    """
    _refuse_deployed(logged, "resume")
    if log is not None and Path(log).resolve() == logged.log.resolve():
        raise LogError(f"log: {log}: is the log that the flight is resumed from; it must be another file")
    state_time = _state_before(logged, at)
    simulation = Simulation(
        logged.params if params is None else _same_policy(logged.params, check_point(params)),
        _with_duration(logged.scenario, state_time, duration),
        logged.dynamics,
        logged.seed,
    )
    _restore_state(simulation, logged, state_time)
    if simulation.finished:
        raise LogError(f"log: {logged.log}: the flight ends at {simulation.time:g} s; a longer flight needs a duration")
    origin = {RESUMED_FROM: logged.log.name, RESUMED_AT: repr(state_time)}
    return continue_flight(simulation, log=log, origin=origin, keep_samples=keep_samples, progress=progress, stop=stop)


def _same_policy(logged: NamedTuple, params: NamedTuple) -> NamedTuple:
    """New parameters of a flight, with its target if it has one.

    Raises:
        PointError: the parameters are of another policy.
    """
    if isinstance(logged, TargetTrackingParams) and isinstance(params, type(logged.base)):
        return logged._replace(base=params)
    if type(params) is not type(logged):
        raise PointError(
            f"policy: {spec_of(params).name!r} is not that of the log: it must be {spec_of(logged).name!r}"
        )
    return params


def _refuse_deployed(logged: LoggedFlight, what: str) -> None:
    """Refuse the log of a deployed flight.

    Raises:
        LogError: the flight was not simulated.
    """
    if logged.dynamics == DEPLOYED:
        raise LogError(f"{what}: {logged.log} is of vehicles over MAVLink; it must be of a simulated flight")


def _simulation_at_start(logged: LoggedFlight) -> Simulation:
    """Create the simulation in the state before the log's first sample."""
    simulation = Simulation(logged.params, logged.scenario, logged.dynamics, logged.seed)
    if logged.start > 0:
        if not logged.states:
            raise LogError(f"log: {logged.log}: was resumed, but contains no state to start from")
        _restore_state(simulation, logged, min(logged.states))
    return simulation


def _restore_state(simulation: Simulation, logged: LoggedFlight, state_time: float) -> None:
    """Restore a simulation to one of the log's states.

    Raises:
        LogError: the state is of another simulation or another time.
    """
    try:
        simulation.restore(logged.states[state_time])
    except LogError as problem:
        raise LogError(f"log: {logged.log}: at {state_time:g} s: {problem}") from None
    if abs(simulation.time - state_time) > 1e-6:
        raise LogError(f"log: {logged.log}: the state at {state_time:g} s is that of {simulation.time:g} s")


def _state_before(logged: LoggedFlight, at: float) -> float:
    """Time of the latest state up to `at`, s."""
    end = float(logged.samples.t[-1])
    times = sorted(logged.states)
    if not math.isfinite(at) or not 0 <= at <= max(end, logged.flown) + 1e-9:
        raise LogError(f"resume: {at:g} s is out of bounds: the log {logged.log} ends at {end:g} s")
    index = bisect.bisect_right(times, at + 1e-9)
    if not index:
        first = f"its first is at {times[0]:g} s" if times else "it has none"
        raise LogError(f"resume: the log {logged.log} has no state up to {at:g} s; {first}")
    return times[index - 1]


def _with_duration(scenario: Scenario, state_time: float, duration: float | None) -> Scenario:
    """Change the duration of a scenario to end `duration` seconds after a state."""
    if duration is None:
        return scenario
    if not math.isfinite(duration) or duration <= 0:
        raise LogError(f"duration: {duration:g} s is out of bounds: it must be over 0 s")
    # Rounded, so that 10 s and 0.1 s make 10.1 s.
    return scenario.replace(duration=round(state_time + duration, 9))


def _first_difference(logged: LoggedFlight, record: SampleBuffer, first: int) -> Difference | None:
    """First difference between a record, which begins with sample number `first`, and the log."""
    times = sample_times(logged.scenario, first, len(record.nearest)) / 1e9
    _, here, there = np.intersect1d(times, logged.samples.t, assume_unique=True, return_indices=True)
    points = _points_differ(logged, record, here, there)
    running = np.stack(logged.samples.order_parameters, axis=1)[there]
    differ = {
        "state": (state_digests(record.qpos[here], record.qvel[here]) != logged.digests[there]).any(axis=1),
        "points": points.any(axis=1),
        "order parameters": (record.order_parameters[here] != running).any(axis=1),
    }
    different = np.flatnonzero(np.logical_or.reduce(list(differ.values())))
    if not len(different):
        return None
    k = int(different[0])
    drone = int(np.argmax(points[k])) if points[k].any() else None
    what = next(name for name, differs in differ.items() if differs[k])
    return Difference(first + int(here[k]), float(times[here[k]]), drone, what)


def _points_differ(
    logged: LoggedFlight, record: SampleBuffer, here: NDArray[np.intp], there: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """(K, N), True where the logged points `there` differ from the samples `here` of a record."""
    samples = logged.samples
    pairs = (
        (record.qpos[here][..., :3], samples.position),
        (record.qpos[here][..., 3:], logged.quaternion),
        (record.qvel[here][..., :3], samples.velocity),
        (record.qvel[here][..., 3:], logged.body_rates),
        (record.desired[here].swapaxes(1, 2), samples.desired_velocity),
    )
    with np.errstate(over="ignore"):  # a diverged body is logged as infinity
        differ = [(computed.astype(np.float32) != stored[there]).any(axis=-1) for computed, stored in pairs]
    return np.asarray(np.any(differ, axis=0), bool)


def _changes(logged: LoggedFlight, simulation: Simulation) -> tuple[VersionChange, ...]:
    """Differences of versions and machine between the log and here."""
    here = run_metadata(simulation)
    pairs = [(label, logged.metadata.get(name, ""), here[name]) for name, label in _VERSIONS.items()]
    return tuple(VersionChange(*pair) for pair in pairs if pair[1] != pair[2])
