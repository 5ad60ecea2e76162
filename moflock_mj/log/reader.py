"""Reads a finished log back into a flight."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from controllers.compiling import entry_kernel
from controllers.policies.registry import DEFAULT_POLICY
from moflock_mj.errors import LogError, MoflockError
from moflock_mj.log.mcap_records import (
    ChunkUnpacker,
    DamageError,
    Summary,
    map_file,
    printable,
    read_attachment,
    read_channel,
    read_message,
    read_metadata,
    read_summary,
    record_at,
    records_in,
)
from moflock_mj.log.schemas import (
    LOG_VERSION,
    RESULT_METADATA,
    RESUMED_AT,
    RUN_COPY,
    RUN_METADATA,
    SimState,
    WireRecord,
    frame_name,
    metrics_record,
    points_record,
)
from moflock_mj.metrics.catalogue import METRICS
from moflock_mj.metrics.events import FlightEvent
from moflock_mj.metrics.fitness import Fitness
from moflock_mj.metrics.order_parameters import CLOSE, OUTSIDE, TOUCHED, OrderParameters
from moflock_mj.metrics.samples import Samples
from moflock_mj.parameters.points import find_policy, point_from_values
from moflock_mj.scenario.scenario import DEFAULT_STEP, DEPLOYED, Scenario
from moflock_mj.simulation.results import AnyFlight

_LEVELS: dict[int, Any] = {Log.INFO: "info", Log.WARNING: "warning", Log.ERROR: "error"}

_READ = ("/swarm/points", "/metrics", "/log", "/sim/state")
"""Topics that are read; the others repeat them for viewers."""

_NO_FLIGHT = f"is no log of a flight: it has no record {RUN_METADATA}"

_LATEST_NS = 1 << 53
"""ns; simulated times up to 100 days, which a float tells apart."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class LoggedFlight(AnyFlight):
    """A flight as its log tells it: T samples of N drones.

    Positions, velocities and commands were rounded to single precision, and `samples.nearest` is measured on them. Of a
    drone's flags only the worst was kept: TOUCHED hides CLOSE, which hides OUTSIDE.

    Attributes:
        samples: never None; a log that was resumed begins with the first sample after its state.
        log: where it was read from.
        start: s, the state from which the flight was resumed; 0 for one that is logged from its beginning.
        quaternion: (T, N, 4), w x y z, from body to world.
        body_rates: (T, N, 3), rad/s, body.
        running_fitness: arrays over (T,).
        digests: (T, 16), of the exact states, see `log_schemas.state_digests`.
        states: whole states by simulated time in s, as `Simulation.restore` takes them.
        metadata: how the flight came about: versions, commit, processor, time.
        result: the figures of the flight's end; empty if the log was recovered without them.
        attachments: files by name.
    """

    samples: Samples
    log: Path
    start: float
    quaternion: npt.NDArray[np.float64]
    body_rates: npt.NDArray[np.float64]
    running_fitness: Fitness
    digests: npt.NDArray[np.uint8]
    states: Mapping[float, bytes]
    metadata: Mapping[str, str]
    result: Mapping[str, str]
    attachments: Mapping[str, bytes]

    @property
    def missing(self) -> float:
        """Simulated time before the last sample that the log has lost, s; 0 but for a recovered log."""
        period, times = self.scenario.sample_period, self.samples.t
        # Each sample stands for the time before it, so that the one at the start stands for none.
        kept = int(np.sum(times > self.start)) * period
        return max(round(float(times[-1]) - self.start - kept, 9), 0.0)


def read_log(path: str | Path) -> LoggedFlight:
    """Read a log.

    Raises:
        LogError: not a log of a flight, one of a newer moflock, or one that is unfinished, cut off or damaged.
    """
    path = Path(path)
    data = map_file(path)
    if data[: len(MCAP0_MAGIC)] != MCAP0_MAGIC:
        raise LogError(f"log: {path}: is not an MCAP file")
    try:
        content = read_content(data)
    except DamageError as problem:
        if not re.search(re.escape(RUN_METADATA.encode()), data):
            raise LogError(f"log: {path}: {_NO_FLIGHT}") from None
        hint = f"`moflock replay --recover {path}` saves what is intact"
        raise LogError(f"log: {path}: {problem}; {hint}") from None
    try:
        return flight_of(path, content)
    except (DamageError, MoflockError) as problem:
        raise LogError(f"log: {path}: {problem}") from None


def run_facts(metadata: Mapping[str, str]) -> tuple[Scenario, NamedTuple, str, int]:
    """What the record `moflock.run` says was flown: scenario, parameters, dynamics, seed.

    Raises:
        DamageError: it lacks something, or says what cannot be.
        MoflockError: the scenario or the parameters are not valid.
    """
    field = "log_version"
    try:
        log_version = int(metadata[field])
        if log_version > LOG_VERSION:
            raise DamageError(f"log_version: {log_version} is newer than {LOG_VERSION}; a newer moflock reads it")
        if log_version < LOG_VERSION:
            raise DamageError(f"log_version: {log_version} is older than {LOG_VERSION}; an older moflock reads it")
        field = "parameters"
        params = point_from_values(find_policy(metadata.get("policy", DEFAULT_POLICY)), json.loads(metadata[field]))
        field = "scenario"
        scenario = Scenario.from_toml(metadata[field])
        field = "seed"
        seed = int(metadata[field])
        field = "dynamics"
        if (dynamics := metadata[field]) not in (*DEFAULT_STEP, DEPLOYED):
            raise ValueError
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError):
        raise DamageError(f"{field}: {printable(metadata.get(field, 'missing'))!r} is no {field} of a flight") from None
    return scenario, params, dynamics, seed


def run_copy(attachments: Mapping[str, bytes]) -> dict[str, str] | None:
    """The record `moflock.run` as the attachments repeat it under a checksum, which the record itself lacks."""
    try:
        copied = json.loads(attachments[RUN_COPY])
        return {str(name): str(value) for name, value in copied.items()}
    except (KeyError, ValueError, AttributeError, RecursionError):
        return None


class _Channel(NamedTuple):
    """The messages of a topic."""

    time_ns: list[int]
    data: list[bytes]


class LogContent(NamedTuple):
    """What a file holds, its messages by topic; not yet understood."""

    metadata: dict[str, dict[str, str]]
    attachments: dict[str, bytes]
    channels: dict[str, _Channel]


def read_content(data: memoryview) -> LogContent:
    """Read a whole file, with all its checksums.

    Raises:
        DamageError: something is missing or damaged.
    """
    summary, seen = read_summary(data), defaultdict[int, int](int)
    content = LogContent({}, {}, {topic: _Channel([], []) for topic in _READ})
    by_number: dict[int, _Channel] = {}
    unpacker, position = ChunkUnpacker(len(data)), len(MCAP0_MAGIC)
    while (record := record_at(data, position)).opcode != Opcode.DATA_END:
        seen[record.opcode] += 1
        match record.opcode:
            case Opcode.METADATA:
                name, entries = read_metadata(record.content)
                content.metadata[name] = entries
            case Opcode.ATTACHMENT:
                attached = read_attachment(record.content)
                content.attachments[attached.name] = attached.data
            case Opcode.CHUNK:
                _read_messages(unpacker.unpack(record.content), content.channels, by_number)
        position = record.end
    # A record whose very kind was damaged has been passed over.
    counted = Summary(seen[Opcode.ATTACHMENT], seen[Opcode.METADATA], seen[Opcode.CHUNK], *summary[3:])
    if counted != summary:
        raise DamageError("holds less than its summary says")
    if RUN_COPY in content.attachments and run_copy(content.attachments) != content.metadata.get(RUN_METADATA):
        raise DamageError(f"its record {RUN_METADATA} and the copy {RUN_COPY} differ")
    return content


def _read_messages(chunk: memoryview, channels: Mapping[str, _Channel], by_number: dict[int, _Channel]) -> None:
    """Sort a chunk's messages by topic, as far as they are to be read."""
    for record in records_in(chunk):
        if record.opcode == Opcode.MESSAGE:
            message = read_message(record.content)
            if channel := by_number.get(message.channel):
                channel.time_ns.append(message.time_ns)
                channel.data.append(bytes(message.data))
        elif record.opcode == Opcode.CHANNEL:
            number, topic = read_channel(record.content)
            if topic in channels:
                by_number[number] = channels[topic]


def flight_of(path: Path, content: LogContent) -> LoggedFlight:
    """The flight that a file tells of.

    Raises:
        DamageError: it is not laid out as a flight's log.
        MoflockError: the scenario or the parameters are not valid.
    """
    if RUN_METADATA not in content.metadata:
        raise DamageError(_NO_FLIGHT)
    run, result = content.metadata[RUN_METADATA], content.metadata.get(RESULT_METADATA, {})
    scenario, params, dynamics, seed = run_facts(run)
    deployed = dynamics == DEPLOYED
    # The time of a deployed flight counts from before its take-off; its duration is that in the flock.
    latest = _LATEST_NS if deployed else round(scenario.duration * 1e9)
    times, clouds, metrics = _ticks(content.channels, scenario, latest)
    end = float(times[-1]) / 1e9
    values = metrics["values"]["value"].T.copy()
    points = clouds["points"]
    position = points["qpos"][..., :3].astype(np.float64)
    return LoggedFlight(
        params=params,
        scenario=scenario,
        dynamics=dynamics,
        seed=seed,
        flown=_time_told(result.get("flown", ""), 0.0 if deployed else end, scenario.duration, end),
        order_parameters=OrderParameters(*values[: len(METRICS), -1].tolist()),
        fitness=Fitness(*values[len(METRICS) :, -1].tolist()),
        samples=Samples(
            t=times / 1e9,
            position=position,
            velocity=points["qvel"][..., :3].astype(np.float64),
            desired_velocity=points["desired_velocity"][..., :2].astype(np.float64),
            status=_status(points["status"]),
            nearest=_nearest(position),
            order_parameters=OrderParameters(*values[: len(METRICS)]),
        ),
        events=_events(content.channels["/log"], scenario.drones),
        log=path,
        start=_time_told(run.get(RESUMED_AT, ""), 0.0, times[0] / 1e9, 0.0),
        quaternion=points["qpos"][..., 3:].astype(np.float64),
        body_rates=points["qvel"][..., 3:].astype(np.float64),
        running_fitness=Fitness(*values[len(METRICS) :]),
        digests=metrics["digest"].copy(),
        states=_states(content.channels["/sim/state"]),
        metadata=run,
        result=result,
        attachments=content.attachments,
    )


def _ticks(
    channels: Mapping[str, _Channel], scenario: Scenario, latest: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[Any], npt.NDArray[Any]]:
    """The times in ns, points and metrics of all ticks that have both; a log may end between the two."""
    points, metrics = channels["/swarm/points"], channels["/metrics"]
    clouds = _rows("/swarm/points", points.data, points_record(scenario.drones), scenario.drones)
    figures = _rows("/metrics", metrics.data, metrics_record(), scenario.drones)
    times, with_points, with_metrics = np.intersect1d(
        _sample_times("/swarm/points", points, scenario.sample_period, latest),
        _sample_times("/metrics", metrics, scenario.sample_period, latest),
        assume_unique=True,
        return_indices=True,
    )
    if not len(times):
        raise DamageError("holds no samples")
    return times, clouds[with_points], figures[with_metrics]


def _sample_times(topic: str, channel: _Channel, period: float, latest: int) -> npt.NDArray[np.int64]:
    """The times of a topic's messages, ns; samples come every `period` s, none after `latest`, ns.

    Raises:
        DamageError: they are not those of a flight's samples, one after the other.
    """
    if max(channel.time_ns, default=0) > _LATEST_NS:
        raise DamageError(f"{topic}: the time {max(channel.time_ns)} ns is out of bounds: at most {_LATEST_NS} ns")
    times = np.array(channel.time_ns, np.int64)
    if (np.diff(times) <= 0).any() or (times % round(period * 1e9)).any() or times.max(initial=0) > latest:
        raise DamageError(f"{topic}: its times are not those of samples every {period:g} s")
    return times


def _rows(topic: str, messages: list[bytes], record: WireRecord, drones: int) -> npt.NDArray[Any]:
    """Messages of a constant length as NumPy records; (T,).

    Raises:
        DamageError: one of them is laid out otherwise.
    """
    size = len(record.constant)
    for message in messages:
        if len(message) != size:
            raise DamageError(f"{topic}: a message of {len(message)} bytes; with {drones} drones it must be {size}")
    joined = np.frombuffer(b"".join(messages), np.uint8)
    fixed = np.ones(size, bool)
    for dtype, offset in (field[:2] for field in (record.dtype.fields or {}).values()):
        fixed[offset : offset + dtype.itemsize] = False
    if (joined.reshape(-1, size)[:, fixed] != np.frombuffer(record.constant, np.uint8)[fixed]).any():
        raise DamageError(f"{topic}: a message is not laid out as in a log of version {LOG_VERSION}")
    return joined.view(record.dtype)


def _status(flags: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """(T, N) flags, checked."""
    if (flags > OUTSIDE | CLOSE | TOUCHED).any():
        raise DamageError("/swarm/points: a status is none")
    return flags.copy()


@entry_kernel
def _nearest(position: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(T,) smallest distances between two drones, m, of (T, N, 3) positions; infinite for one drone."""
    ticks, drones = position.shape[:2]
    nearest = np.full(ticks, math.inf)
    for k in range(ticks):
        for i in range(drones):
            for j in range(i + 1, drones):
                dx = position[k, j, 0] - position[k, i, 0]
                dy = position[k, j, 1] - position[k, i, 1]
                dz = position[k, j, 2] - position[k, i, 2]
                nearest[k] = min(nearest[k], dx * dx + dy * dy + dz * dz)
    nearest[:] = np.sqrt(nearest)
    return nearest


def _events(channel: _Channel, drones: int) -> tuple[FlightEvent, ...]:
    """Events in the order of the log."""
    numbers = {frame_name(drone, drones): drone for drone in range(drones)} | {"flock": -1}
    events = []
    for time_ns, data in zip(*channel, strict=True):
        try:
            told = Log.FromString(data)
            events.append(FlightEvent(time_ns, _LEVELS[told.level], printable(told.message), numbers[told.name]))
        except (DecodeError, KeyError):
            raise DamageError("/log: a message is no event of a flight") from None
    return tuple(events)


def _states(channel: _Channel) -> dict[float, bytes]:
    """Whole states by simulated time, s."""
    states = {}
    for time_ns, data in zip(*channel, strict=True):
        try:
            states[time_ns / 1e9] = bytes(SimState.FromString(data).state)
        except DecodeError:
            raise DamageError("/sim/state: a message is no state of a flight") from None
    return states


def _time_told(text: str, low: float, high: float, default: float) -> float:
    """A time in s of the metadata, if it is one between `low` and `high`."""
    try:
        told = float(text)
    except ValueError:
        return default
    return told if low <= told <= high + 1e-9 else default
