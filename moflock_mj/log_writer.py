"""Writes a flight into one MCAP file, on a thread of its own.

The file is called NAME.mcap.part until it is finished, and its chunk is closed at every simulated second, so that whatever kills the
program costs at most the last second. Nothing in it depends on the wall clock but what the caller puts into the metadata.
"""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import os
import queue
import threading
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Literal, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from moflock_mj.errors import LogError
from moflock_mj.log_scene import scene
from moflock_mj.log_schemas import (
    CHANNELS,
    FITNESS_FIELDS,
    LOG_VERSION,
    ORDER_PARAMETER_FIELDS,
    RESULT_METADATA,
    RUN_METADATA,
    STATUS_RGBA,
    SimState,
    fill_integer,
    fill_time,
    frame_name,
    metrics_record,
    points_record,
    schema_of,
    state_digest,
    transforms_record,
)

_SECOND = 1_000_000_000
# Items of some ten ticks each that may wait for the disk before the flight does.
_QUEUE_LENGTH = 32


class SampleBlock(NamedTuple):
    """K consecutive sample ticks. The arrays are the log's to keep: the flight must not write into them again.

    Attributes:
        time_ns: (K,), int64, simulated time in ns.
        qpos: (K, N, 7), position m in the world frame, quaternion wxyz.
        qvel: (K, N, 6), velocity m/s in the world frame, body rates rad/s in the body frame.
        desired_velocity: (K, N, 2), m/s, world, horizontal.
        status: (K, N), uint8: 0 fine, 1 outside the arena, 2 closer than r_coll to another, 3 has touched something.
        order_parameters: (K, 6), running wall, vel, corr, coll, disc, cluster.
        fitness: (K, 9), running wall, speed, corr, coll, disc, cluster, F_1, F_2, product.
    """

    time_ns: npt.NDArray[np.int64]
    qpos: npt.NDArray[np.float64]
    qvel: npt.NDArray[np.float64]
    desired_velocity: npt.NDArray[np.float64]
    status: npt.NDArray[np.uint8]
    order_parameters: npt.NDArray[np.float64]
    fitness: npt.NDArray[np.float64]


class FlightEvent(NamedTuple):
    """Something worth telling: a touch, a breach of the arena, a warning.

    Attributes:
        time_ns: simulated time in ns.
        level: how bad it is.
        message: one line.
        drone: the drone it happened to, or -1.
    """

    time_ns: int
    level: Literal["info", "warning", "error"]
    message: str
    drone: int = -1


class Attachment(NamedTuple):
    """A file inside the log."""

    name: str
    media_type: str
    data: bytes


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class LogHeader:
    """What a log says before its first message.

    Attributes:
        metadata: the record `moflock.run`; `log_version` is added to it.
        attachments: the models, the scenario, the parameters, the viewer layout.
        outline: (M, 2), m, world, corners of the arena's wall in order.
        altitude: m, at which the flock flies.
        drones: how many, N.
        radius: m, of one drone.
        transform_period: every how many ticks /tf is written; viewers interpolate between them.
    """

    metadata: Mapping[str, str]
    attachments: tuple[Attachment, ...]
    outline: npt.NDArray[np.float64]
    altitude: float
    drones: int
    radius: float
    transform_period: int = 1


class FlightLog:
    """A flight's log while it is written; a context manager.

    Leaving the context finishes the log, also after Ctrl-C; any other exception aborts it. What goes wrong on the disk comes up as a
    LogError at the next call, when the unfinished file is already gone.
    """

    def __init__(self, path: str | os.PathLike[str], header: LogHeader) -> None:
        """Open NAME.mcap.part and write all that precedes the flight.

        Raises:
            LogError: the file cannot be written, or another flight is writing it.
        """
        self.path = Path(path)
        self._part = self.path.with_name(self.path.name + ".part")
        self._drones = header.drones
        self._failure: Exception | None = None
        self._closed = False
        try:
            self._stream = _open(self.path, self._part)
        except OSError as failure:
            raise _log_error(self.path, failure) from failure
        try:
            self._encoder = _Encoder(self._stream, header)
        except BaseException as failure:
            self._remove()
            if isinstance(failure, OSError):
                raise _log_error(self.path, failure) from failure
            raise
        self._queue: queue.Queue[Any] = queue.Queue(_QUEUE_LENGTH)
        # A daemon, so that a program that dies without closing its log does not wait for it for ever.
        self._thread = threading.Thread(target=self._run, name=f"log {self.path.name}", daemon=True)
        self._thread.start()

    def write(self, block: SampleBlock) -> None:
        """Hand over sample ticks, which follow those handed over before.

        Raises:
            ValueError: an array has the wrong shape.
            LogError: the log could not be written.
        """
        _check(block, self._drones)
        self._put(block)

    def event(self, event: FlightEvent) -> None:
        """Record an event, in the place where it comes between the blocks."""
        self._put(event)

    def state(self, time_ns: int, state: bytes) -> None:
        """Record the complete state from which the flight can be resumed.

        Args:
            time_ns: simulated time in ns.
            state: MuJoCo's integration state and all else that the flight carries from step to step.
        """
        self._put(_State(time_ns, state))

    def finish(self, result: Mapping[str, str] | None = None) -> None:
        """Write the result and the index, and give the file its name; later calls do nothing.

        Args:
            result: the record `moflock.result`, the final figures.

        Raises:
            LogError: the log could not be written.
        """
        if self._closed:
            return
        self._queue.put(_Finish(result))
        self._thread.join()
        self._raise_failure()
        self._closed = True

    def abort(self) -> None:
        """Stop writing and remove the unfinished file; does nothing after `finish`."""
        if self._closed:
            return
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()
        self._remove()
        self._closed = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, Exception):
            self.abort()
        else:
            self.finish()

    def _put(self, item: Any) -> None:
        self._raise_failure()
        if self._closed:
            raise ValueError(f"log: {self.path}: is closed")
        self._queue.put(item)

    def _raise_failure(self) -> None:
        if self._failure is not None:
            self.abort()
            raise _log_error(self.path, self._failure) from self._failure

    def _remove(self) -> None:
        # Closing tries once more to write what a full disk has refused.
        with contextlib.suppress(OSError):
            self._stream.close()
        with contextlib.suppress(OSError):
            self._part.unlink()

    def _run(self) -> None:
        """The writer thread: after a failure it goes on taking items, so that the flight never waits for a full queue."""
        while True:
            item = self._queue.get()
            if self._failure is None:
                try:
                    self._handle(item)
                except Exception as failure:
                    self._failure = failure
            if item is None or isinstance(item, _Finish):
                return

    def _handle(self, item: Any) -> None:
        match item:
            case SampleBlock():
                self._encoder.block(item)
            case FlightEvent():
                self._encoder.event(item)
            case _State():
                self._encoder.state(item)
            case _Finish():
                self._encoder.finish(item.result)
                self._part.replace(self.path)
                self._stream.close()


class _State(NamedTuple):
    time_ns: int
    state: bytes


class _Finish(NamedTuple):
    result: Mapping[str, str] | None


class _Encoder:
    """Turns blocks, events and states into the messages of an MCAP stream."""

    def __init__(self, stream: IO[bytes], header: LogHeader) -> None:
        self._stream = stream
        self._writer = Writer(stream)
        self._drones = header.drones
        self._transform_period = header.transform_period
        self._points = points_record(header.drones)
        self._transforms = transforms_record(header.drones)
        self._metrics = metrics_record()
        self._tick = 0
        self._next_flush = _SECOND
        self._writer.start()
        self._writer.add_metadata(RUN_METADATA, {"log_version": str(LOG_VERSION), **header.metadata})
        for name, media_type, data in header.attachments:
            self._writer.add_attachment(0, 0, name, media_type, data)
        self._channels = {topic: self._channel(topic, message) for topic, message in CHANNELS.items()}
        still = scene(header.outline, header.altitude, header.drones, header.radius)
        self._add("/scene", 0, still.SerializeToString())
        self._flush()

    def block(self, block: SampleBlock) -> None:
        count = len(block.time_ns)
        ticks = self._tick + np.arange(count)
        posed = np.flatnonzero(ticks % self._transform_period == 0)
        points = self._point_rows(block)
        metrics = self._metric_rows(block, ticks)
        transforms = dict(zip(posed.tolist(), self._transform_rows(block, posed), strict=True))
        for row, (tick, time_ns) in enumerate(zip(ticks.tolist(), block.time_ns.tolist(), strict=True)):
            self._add("/swarm/points", time_ns, points[row].tobytes(), tick)
            if row in transforms:
                self._add("/tf", time_ns, transforms[row].tobytes(), tick)
            self._add("/metrics", time_ns, metrics[row].tobytes(), tick)
            if time_ns >= self._next_flush:
                self._flush()
                self._next_flush = (time_ns // _SECOND + 1) * _SECOND
        self._tick += count

    def event(self, event: FlightEvent) -> None:
        seconds, nanos = divmod(event.time_ns, _SECOND)
        name = "flock" if event.drone < 0 else frame_name(event.drone, self._drones)
        message = Log(level=Log.Level.Value(event.level.upper()), message=event.message, name=name)
        message.timestamp.seconds, message.timestamp.nanos = seconds, nanos
        self._add("/log", event.time_ns, message.SerializeToString())

    def state(self, state: _State) -> None:
        message = SimState(version=LOG_VERSION, state=state.state)
        self._add("/sim/state", state.time_ns, message.SerializeToString())

    def finish(self, result: Mapping[str, str] | None) -> None:
        self._flush()
        if result is not None:
            self._writer.add_metadata(RESULT_METADATA, dict(result))
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.flush()

    def _channel(self, topic: str, message_class: Any) -> int:
        name, descriptors = schema_of(message_class)
        schema = self._writer.register_schema(name, SchemaEncoding.Protobuf, descriptors)
        return self._writer.register_channel(topic, MessageEncoding.Protobuf, schema)

    def _add(self, topic: str, time_ns: int, data: bytes, tick: int = 0) -> None:
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns, tick)

    def _flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]

    def _point_rows(self, block: SampleBlock) -> npt.NDArray[Any]:
        rows = self._points.rows(len(block.time_ns))
        fill_time(rows, block.time_ns)
        drones = rows["points"]
        # A body that has gone wild may leave what a float of four bytes can hold; that is infinity then.
        with np.errstate(over="ignore"):
            drones["qpos"] = block.qpos
            drones["qvel"] = block.qvel
            drones["desired_velocity"][..., :2] = block.desired_velocity
        drones["rgba"] = STATUS_RGBA[block.status]
        return rows

    def _transform_rows(self, block: SampleBlock, posed: npt.NDArray[np.intp]) -> npt.NDArray[Any]:
        rows = self._transforms.rows(len(posed))
        drones = rows["drones"]
        qpos = block.qpos[posed]
        fill_time(drones, block.time_ns[posed, None])
        drones["translation"]["value"] = qpos[..., :3]
        drones["rotation"]["value"][..., :3] = qpos[..., 4:]
        drones["rotation"]["value"][..., 3] = qpos[..., 3]
        return rows

    def _metric_rows(self, block: SampleBlock, ticks: npt.NDArray[np.int64]) -> npt.NDArray[Any]:
        rows = self._metrics.rows(len(ticks))
        fill_integer(rows["tick"], ticks)
        values = rows["values"]["value"]
        values[:, : len(ORDER_PARAMETER_FIELDS)] = block.order_parameters
        values[:, len(ORDER_PARAMETER_FIELDS) :] = block.fitness
        digests = [state_digest(qpos, qvel) for qpos, qvel in zip(block.qpos, block.qvel, strict=True)]
        rows["digest"] = np.frombuffer(b"".join(digests), np.uint8).reshape(rows["digest"].shape)
        return rows


def _check(block: SampleBlock, drones: int) -> None:
    ticks = len(block.time_ns)
    shapes = {
        "time_ns": (ticks,),
        "qpos": (ticks, drones, 7),
        "qvel": (ticks, drones, 6),
        "desired_velocity": (ticks, drones, 2),
        "status": (ticks, drones),
        "order_parameters": (ticks, len(ORDER_PARAMETER_FIELDS)),
        "fitness": (ticks, len(FITNESS_FIELDS)),
    }
    for name, shape in shapes.items():
        if getattr(block, name).shape != shape:
            raise ValueError(f"{name}: shape {getattr(block, name).shape} given, {shape} expected")


def _open(path: Path, part: Path) -> IO[bytes]:
    """Open the unfinished file for this process alone; one that a dead process left is overwritten."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.is_dir():
        raise IsADirectoryError(None, "is a folder")
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o666)
    try:
        # Emptied only once it is ours.
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.ftruncate(descriptor, 0)
    except BaseException:
        os.close(descriptor)
        raise
    return os.fdopen(descriptor, "wb")


def _log_error(path: Path, failure: Exception) -> LogError:
    """One line that names the file and what is wrong with it."""
    match failure:
        case BlockingIOError():
            reason = "another flight is writing it"
        case FileExistsError() | NotADirectoryError():
            reason = f"{path.parent} is not a folder"
        case OSError(strerror=str(text)):
            reason = text[:1].lower() + text[1:]
        case _:
            reason = f"{type(failure).__name__}: {failure}"
    return LogError(f"log: {path}: {reason}")
