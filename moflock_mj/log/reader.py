"""Reader of complete logs."""

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
"""Topics of the reader; the others repeat their data for viewers."""

_NO_FLIGHT = f"is not a log of a flight: it has no record {RUN_METADATA}"

_LATEST_NS = 1 << 53
"""Largest simulated time, about 100 days, ns; larger times are not exact in a float."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class LoggedFlight(AnyFlight):
    """Flight from a log: T samples of N drones.

    Positions, velocities and commands have single precision, and `samples.nearest` is computed from them. Of a
    drone's flags only the worst was kept: TOUCHED hides CLOSE, which hides OUTSIDE.

    Attributes:
        samples: samples of the flight, never None; those of a resumed flight begin after its first state.
        log: path of the log.
        start: time of the state from which the flight was resumed, s; 0 for a log from the beginning.
        quaternion: (T, N, 4), w x y z, from body to world.
        body_rates: (T, N, 3), body rates, rad/s, body.
        running_fitness: running fitness, arrays over (T,).
        digests: (T, 16), digests of the exact states, see `moflock_mj.log.schemas.state_digests`.
        states: complete states for `Simulation.restore`, by simulated time in s.
        metadata: inputs of the flight, versions, commit, processor and time.
        result: final figures of the flight; empty if the log was recovered without them.
        attachments: contents of the attached files, by name.
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
        """Simulated time of lost samples before the last one, s; 0 except in a recovered log."""
        period, times = self.scenario.sample_period, self.samples.t
        # Each sample represents the period before it, so that the initial one represents none.
        kept = int(np.sum(times > self.start)) * period
        return max(round(float(times[-1]) - self.start - kept, 9), 0.0)


def read_log(path: str | Path) -> LoggedFlight:
    """Read a log.

    Raises:
        LogError: not a log of a flight, or a log that is newer, unfinished, cut off or damaged.
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
    """Scenario, parameters, dynamics and seed from the record `moflock.run`.

    Raises:
        DamageError: an entry is missing or invalid.
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
        raise DamageError(
            f"{field}: {printable(metadata.get(field, 'missing'))!r} is not the {field} of a flight"
        ) from None
    return scenario, params, dynamics, seed


def run_copy(attachments: Mapping[str, bytes]) -> dict[str, str] | None:
    """Copy of the record `moflock.run` in the attachments, which have a checksum; None if absent or invalid."""
    try:
        copied = json.loads(attachments[RUN_COPY])
        return {str(name): str(value) for name, value in copied.items()}
    except (KeyError, ValueError, AttributeError, RecursionError):
        return None


class _Channel(NamedTuple):
    """Messages of a topic."""

    time_ns: list[int]
    data: list[bytes]


class LogContent(NamedTuple):
    """Content of a file, with undecoded messages by topic."""

    metadata: dict[str, dict[str, str]]
    attachments: dict[str, bytes]
    channels: dict[str, _Channel]


def read_content(data: memoryview) -> LogContent:
    """Read a file and verify all its checksums.

    Raises:
        DamageError: a part of the file is missing or damaged.
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
    # The count detects a record with a damaged opcode, which was skipped.
    counted = Summary(seen[Opcode.ATTACHMENT], seen[Opcode.METADATA], seen[Opcode.CHUNK], *summary[3:])
    if counted != summary:
        raise DamageError("contains less than its summary states")
    if RUN_COPY in content.attachments and run_copy(content.attachments) != content.metadata.get(RUN_METADATA):
        raise DamageError(f"its record {RUN_METADATA} and the copy {RUN_COPY} differ")
    return content


def _read_messages(chunk: memoryview, channels: Mapping[str, _Channel], by_number: dict[int, _Channel]) -> None:
    """Append the messages of a chunk to the channels of their topics."""
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
    """Decode the flight in a file.

    Raises:
        DamageError: the layout is not that of a log.
        MoflockError: the scenario or the parameters are not valid.
    """
    if RUN_METADATA not in content.metadata:
        raise DamageError(_NO_FLIGHT)
    run, result = content.metadata[RUN_METADATA], content.metadata.get(RESULT_METADATA, {})
    scenario, params, dynamics, seed = run_facts(run)
    deployed = dynamics == DEPLOYED
    # The times of a deployed flight start before take-off; its duration is the time in the flock.
    latest = _LATEST_NS if deployed else round(scenario.duration * 1e9)
    times, clouds, metrics = _samples(content.channels, scenario, latest)
    end = float(times[-1]) / 1e9
    values = metrics["values"]["value"].T.copy()
    points = clouds["points"]
    position = points["qpos"][..., :3].astype(np.float64)
    return LoggedFlight(
        params=params,
        scenario=scenario,
        dynamics=dynamics,
        seed=seed,
        flown=_time_from_text(result.get("flown", ""), 0.0 if deployed else end, scenario.duration, end),
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
        start=_time_from_text(run.get(RESUMED_AT, ""), 0.0, times[0] / 1e9, 0.0),
        quaternion=points["qpos"][..., 3:].astype(np.float64),
        body_rates=points["qvel"][..., 3:].astype(np.float64),
        running_fitness=Fitness(*values[len(METRICS) :]),
        digests=metrics["digest"].copy(),
        states=_states(content.channels["/sim/state"]),
        metadata=run,
        result=result,
        attachments=content.attachments,
    )


def _samples(
    channels: Mapping[str, _Channel], scenario: Scenario, latest: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[Any], npt.NDArray[Any]]:
    """Times (ns), points and metrics of all samples that have both; a log may end between the two."""
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
        raise DamageError("contains no samples")
    return times, clouds[with_points], figures[with_metrics]


def _sample_times(topic: str, channel: _Channel, period: float, latest: int) -> npt.NDArray[np.int64]:
    """Times of a topic's messages, ns, checked to be increasing multiples of `period` (s) up to `latest` (ns).

    Raises:
        DamageError: the times are not those of samples.
    """
    if max(channel.time_ns, default=0) > _LATEST_NS:
        raise DamageError(f"{topic}: the time {max(channel.time_ns)} ns is out of bounds: at most {_LATEST_NS} ns")
    times = np.array(channel.time_ns, np.int64)
    if (np.diff(times) <= 0).any() or (times % round(period * 1e9)).any() or times.max(initial=0) > latest:
        raise DamageError(f"{topic}: its times are not those of samples every {period:g} s")
    return times


def _rows(topic: str, messages: list[bytes], record: WireRecord, drones: int) -> npt.NDArray[Any]:
    """Messages of constant length as NumPy records, (T,).

    Raises:
        DamageError: a message has another layout.
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
        raise DamageError("/swarm/points: a status is invalid")
    return flags.copy()


@entry_kernel
def _nearest(position: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Smallest distance between two drones, (T,), m, from positions (T, N, 3); infinite for one drone."""
    samples, drones = position.shape[:2]
    nearest = np.full(samples, math.inf)
    for k in range(samples):
        for i in range(drones):
            for j in range(i + 1, drones):
                dx = position[k, j, 0] - position[k, i, 0]
                dy = position[k, j, 1] - position[k, i, 1]
                dz = position[k, j, 2] - position[k, i, 2]
                nearest[k] = min(nearest[k], dx * dx + dy * dy + dz * dz)
    nearest[:] = np.sqrt(nearest)
    return nearest


def _events(channel: _Channel, drones: int) -> tuple[FlightEvent, ...]:
    """Events, in the order of the log."""
    numbers = {frame_name(drone, drones): drone for drone in range(drones)} | {"flock": -1}
    events = []
    for time_ns, data in zip(*channel, strict=True):
        try:
            message = Log.FromString(data)
            events.append(
                FlightEvent(time_ns, _LEVELS[message.level], printable(message.message), numbers[message.name])
            )
        except (DecodeError, KeyError):
            raise DamageError("/log: a message is not an event of a flight") from None
    return tuple(events)


def _states(channel: _Channel) -> dict[float, bytes]:
    """Complete states by simulated time, s."""
    states = {}
    for time_ns, data in zip(*channel, strict=True):
        try:
            states[time_ns / 1e9] = bytes(SimState.FromString(data).state)
        except DecodeError:
            raise DamageError("/sim/state: a message is not a state of a flight") from None
    return states


def _time_from_text(text: str, low: float, high: float, default: float) -> float:
    """Time in s from metadata, or `default` if it is not between `low` and `high`."""
    try:
        value = float(text)
    except ValueError:
        return default
    return value if low <= value <= high + 1e-9 else default
