"""Turns the samples of a flight into the messages of an MCAP stream."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import IO, Any, NamedTuple

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from moflock_mj.events import FlightEvent
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
    transform_period: int = 5


class FlightState(NamedTuple):
    """All that the flight carries from one step to the next, as bytes, at a simulated time in ns."""

    time_ns: int
    state: bytes


class Encoder:
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
        self._written = 0  # simulated ns of the last tick, and of the last one that is with the operating system
        self._flushed = 0
        self._writer.start()
        self._writer.add_metadata(RUN_METADATA, {"log_version": str(LOG_VERSION), **header.metadata})
        for name, media_type, data in header.attachments:
            self._writer.add_attachment(0, 0, name, media_type, data)
        self._channels = {topic: self._channel(topic, message) for topic, message in CHANNELS.items()}
        still = scene(header.outline, header.altitude, header.drones, header.radius)
        self._add("/scene", 0, still.SerializeToString())
        self._flush()

    def block(self, block: SampleBlock) -> None:
        """Write K ticks."""
        count = len(block.time_ns)
        if not count:
            return
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
        self._tick += count
        self._flush_in_time(int(block.time_ns[-1]))

    def event(self, event: FlightEvent) -> None:
        """Write an event."""
        seconds, nanos = divmod(event.time_ns, _SECOND)
        name = "flock" if event.drone < 0 else frame_name(event.drone, self._drones)
        message = Log(level=Log.Level.Value(event.level.upper()), message=event.message, name=name)
        message.timestamp.seconds, message.timestamp.nanos = seconds, nanos
        self._add("/log", event.time_ns, message.SerializeToString())

    def state(self, state: FlightState) -> None:
        """Write a state to resume from."""
        message = SimState(version=LOG_VERSION, state=state.state)
        self._add("/sim/state", state.time_ns, message.SerializeToString())

    def finish(self, result: Mapping[str, str] | None) -> None:
        """Write the result and the index, all of which is with the operating system afterwards."""
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

    def _flush_in_time(self, time_ns: int) -> None:
        """Close the chunk if a program killed before its next block would otherwise lose more than a second.

        What it loses is all that waits in the chunk and the block that it is flying, taken to be as long as the last.
        """
        if (time_ns - self._flushed) + (time_ns - self._written) > _SECOND:
            self._flush()
            self._flushed = time_ns
        self._written = time_ns

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


def check_shapes(block: SampleBlock, drones: int) -> None:
    """Refuse a block whose arrays do not fit together.

    Raises:
        ValueError: names the array, its shape and the one that is expected.
    """
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
