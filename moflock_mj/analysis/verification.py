"""Flies a logged flight again: from its start, as proof that the log tells the truth, or on from one of its states."""

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
"""Simulated seconds that are flown between two comparisons."""

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
"""What may change the last bit of a flight, in the order in which it is suspected."""


class VersionChange(NamedTuple):
    """Something that the flight was logged with and that is another one here."""

    name: str
    logged: str
    here: str


class Difference(NamedTuple):
    """Where the flown flight first leaves the logged one.

    Attributes:
        tick: number of the sample, from 0 at the flight's start.
        time: s.
        drone: the first drone whose logged point differs; None if they differ by less than single precision shows.
        what: what differs: "state", "points" or "order parameters".
    """

    tick: int
    time: float
    drone: int | None
    what: str


@dataclasses.dataclass(frozen=True, kw_only=True)
class Verification:
    """What came of flying a log's flight again.

    Attributes:
        log: the log.
        ticks: samples compared, up to and with the one that differs.
        start: s, time of the state from which the flight was flown again; 0 unless the log itself was resumed.
        time: s, of the last sample compared.
        duration: s, of the log's scenario.
        difference: the first one; None if all is bit-identical.
        changes: what is another version here than in the log; the likely reason of a difference.
        wall_seconds: how long it took.
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
        """Whether every sample of the log came out again, bit by bit."""
        return self.difference is None


def verify(logged: LoggedFlight, progress: Progress | None = None) -> Verification:
    """Fly a log's flight again, as far as the log goes, and compare every sample's digest, points and figures.

    Args:
        logged: a flight as it was read.
        progress: told the simulated time and the running fitness.

    Raises:
        MoflockError: the flight cannot be flown here.
    """
    began = time.perf_counter()
    _refuse_deployed(logged, "verify")
    simulation = _flock_at_start(logged)
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
        wall_seconds=time.perf_counter() - began,
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
    """Fly on from the middle of a log: the latest state that it holds up to `at`.

    With nothing changed, the flight is the original one, bit by bit. Its samples begin after the state; its order
    parameters go on from those of the original flight.

    Args:
        logged: a flight as it was read.
        at: s, simulated.
        params: other parameters to fly on with, to the same target if there is one; the flock is judged by the
            distances that belong to them.
        duration: s, how long to fly on; to the end of the log's scenario if absent.
        log: an MCAP file to be written, or None.
        keep_samples: whether the flight keeps its samples.
        progress: told the simulated time and the running fitness.
        stop: asked now and then; the flight ends, with a finished log, when it says True.

    Raises:
        LogError: the log has no state to fly on from.
        MoflockError: what was asked for cannot be flown.
    """
    _refuse_deployed(logged, "resume")
    if log is not None and Path(log).resolve() == logged.log.resolve():
        raise LogError(f"log: {log}: is the log that the flight is resumed from; it must be another file")
    state_time = _state_before(logged, at)
    simulation = Simulation(
        logged.params if params is None else _same_policy(logged.params, check_point(params)),
        _prolonged(logged.scenario, state_time, duration),
        logged.dynamics,
        logged.seed,
    )
    _put(simulation, logged, state_time)
    if simulation.finished:
        raise LogError(f"log: {logged.log}: the flight ends at {simulation.time:g} s; flying on needs a duration")
    origin = {RESUMED_FROM: logged.log.name, RESUMED_AT: repr(state_time)}
    return continue_flight(simulation, log=log, origin=origin, keep_samples=keep_samples, progress=progress, stop=stop)


def _same_policy(logged: NamedTuple, params: NamedTuple) -> NamedTuple:
    """The new parameters for a flight; flocking around a target keeps its target.

    Raises:
        PointError: they are of another policy.
    """
    if isinstance(logged, TargetTrackingParams) and isinstance(params, type(logged.base)):
        return logged._replace(base=params)
    if type(params) is not type(logged):
        raise PointError(f"policy: {spec_of(params).name!r} is another than the log's, {spec_of(logged).name!r}")
    return params


def _refuse_deployed(logged: LoggedFlight, what: str) -> None:
    """Refuse a flight that was no simulation.

    Raises:
        LogError: it was none.
    """
    if logged.dynamics == DEPLOYED:
        raise LogError(f"{what}: {logged.log} is of vehicles over MAVLink; it must be of a simulated flight")


def _flock_at_start(logged: LoggedFlight) -> Simulation:
    """The log's flock, as it was before the log's first sample."""
    simulation = Simulation(logged.params, logged.scenario, logged.dynamics, logged.seed)
    if logged.start > 0:
        if not logged.states:
            raise LogError(f"log: {logged.log}: was resumed, but holds no state to fly again from")
        _put(simulation, logged, min(logged.states))
    return simulation


def _put(simulation: Simulation, logged: LoggedFlight, state_time: float) -> None:
    """Put a flock into one of the log's states.

    Raises:
        LogError: the state is none of this flock, or of another time than the log says.
    """
    try:
        simulation.restore(logged.states[state_time])
    except LogError as problem:
        raise LogError(f"log: {logged.log}: at {state_time:g} s: {problem}") from None
    if abs(simulation.time - state_time) > 1e-6:
        raise LogError(f"log: {logged.log}: the state at {state_time:g} s is that of {simulation.time:g} s")


def _state_before(logged: LoggedFlight, at: float) -> float:
    """The time of the latest state up to `at`, s."""
    end = float(logged.samples.t[-1])
    times = sorted(logged.states)
    if not math.isfinite(at) or not 0 <= at <= max(end, logged.flown) + 1e-9:
        raise LogError(f"resume: {at:g} s is out of bounds: the log {logged.log} ends at {end:g} s")
    place = bisect.bisect_right(times, at + 1e-9)
    if not place:
        first = f"its first is at {times[0]:g} s" if times else "it has none"
        raise LogError(f"resume: the log {logged.log} has no state up to {at:g} s; {first}")
    return times[place - 1]


def _prolonged(scenario: Scenario, state_time: float, duration: float | None) -> Scenario:
    """The scenario, ending so many seconds after a state."""
    if duration is None:
        return scenario
    if not math.isfinite(duration) or duration <= 0:
        raise LogError(f"duration: {duration:g} s is out of bounds: it must be over 0 s")
    # Rounded, so that 10 s and 0.1 s make 10.1 s.
    return scenario.replace(duration=round(state_time + duration, 9))


def _first_difference(logged: LoggedFlight, record: SampleBuffer, first: int) -> Difference | None:
    """The first sample of a record, whose samples count from `first`, that the log has otherwise."""
    times = sample_times(logged.scenario, first, len(record.nearest)) / 1e9
    _, here, there = np.intersect1d(times, logged.samples.t, assume_unique=True, return_indices=True)
    points = _points_differ(logged, record, here, there)
    running = np.stack(logged.samples.order_parameters, axis=1)[there]
    differ = {
        "state": (state_digests(record.qpos[here], record.qvel[here]) != logged.digests[there]).any(axis=1),
        "points": points.any(axis=1),
        "order parameters": (record.order_parameters[here] != running).any(axis=1),
    }
    ticks = np.flatnonzero(np.logical_or.reduce(list(differ.values())))
    if not len(ticks):
        return None
    k = int(ticks[0])
    drone = int(np.argmax(points[k])) if points[k].any() else None
    what = next(name for name, differs in differ.items() if differs[k])
    return Difference(first + int(here[k]), float(times[here[k]]), drone, what)


def _points_differ(
    logged: LoggedFlight, record: SampleBuffer, here: NDArray[np.intp], there: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """(K, N), which drones' logged points are not those of the record's samples `here`."""
    samples = logged.samples
    pairs = (
        (record.qpos[here][..., :3], samples.position),
        (record.qpos[here][..., 3:], logged.quaternion),
        (record.qvel[here][..., :3], samples.velocity),
        (record.qvel[here][..., 3:], logged.body_rates),
        (record.desired[here].swapaxes(1, 2), samples.desired_velocity),
    )
    with np.errstate(over="ignore"):  # a body gone wild is logged as infinity
        differ = [(flown.astype(np.float32) != told[there]).any(axis=-1) for flown, told in pairs]
    return np.asarray(np.any(differ, axis=0), bool)


def _changes(logged: LoggedFlight, simulation: Simulation) -> tuple[VersionChange, ...]:
    """What is another version here than when the flight was logged."""
    here = run_metadata(simulation)
    pairs = [(label, logged.metadata.get(name, ""), here[name]) for name, label in _VERSIONS.items()]
    return tuple(VersionChange(*pair) for pair in pairs if pair[1] != pair[2])
