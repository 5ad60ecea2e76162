"""Turns the samples of a flight into the messages of an MCAP stream."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import IO, Any, NamedTuple

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.Log_pb2 import Log

from moflock_mj.log.chunk_writer import CHUNK_SIZE, ChunkWriter, message_record, message_rows, row_bytes
from moflock_mj.log.scene_encoder import arena_points, scene
from moflock_mj.log.schemas import (
    CHANNELS,
    FITNESS_FIELDS,
    LOG_VERSION,
    ORDER_PARAMETER_FIELDS,
    RESULT_METADATA,
    RUN_METADATA,
    STATUS_RGBA,
    STATUS_ROW,
    Packet,
    SimState,
    frame_name,
    metrics_record,
    points_record,
    schema_of,
    state_digests,
    timestamps,
    transforms_record,
    varints,
)
from moflock_mj.metrics.events import FlightEvent

_SECOND = 1_000_000_000


class SampleBlock(NamedTuple):
    """K consecutive sample ticks. The arrays are the log's to keep: the flight must not write into them again.

    Attributes:
        time_ns: (K,), int64, simulated time in ns.
        qpos: (K, N, 7), position m in the world frame, quaternion wxyz.
        qvel: (K, N, 6), velocity m/s in the world frame, body rates rad/s in the body frame.
        desired_velocity: (K, N, 2), m/s, world, horizontal.
        status: (K, N), uint8, flags OUTSIDE, CLOSE and TOUCHED of `metrics.order_parameters`.
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


class LinkPacket(NamedTuple):
    """A packet of MAVLink as it went over a link, at a time in ns.

    Attributes:
        time_ns: when.
        system: the vehicle's id; 0: all on the link.
        sent: whether it went to the vehicle.
        packet: its bytes.
    """

    time_ns: int
    system: int
    sent: bool
    packet: bytes


class Encoder:
    """Turns blocks, events and states into the messages of an MCAP stream."""

    def __init__(self, stream: IO[bytes], header: LogHeader) -> None:
        self._file = ChunkWriter(stream)
        self._drones = header.drones
        self._transform_period = header.transform_period
        self._tick = 0
        self._written = 0  # simulated ns of the last tick, and of the last one that is with the operating system
        self._flushed = 0
        self._file.add_metadata(RUN_METADATA, {"log_version": str(LOG_VERSION), **header.metadata})
        for name, media_type, data in header.attachments:
            self._file.add_attachment(name, media_type, data)
        self._channels = {
            topic: self._file.add_channel(topic, *schema_of(message)) for topic, message in CHANNELS.items()
        }
        self._points = message_record(self._channels["/swarm/points"], points_record(header.drones))
        self._transforms = message_record(self._channels["/tf"], transforms_record(header.drones))
        self._metrics = message_record(self._channels["/metrics"], metrics_record())
        # A block that is longer than a chunk is written in pieces.
        tick_size = sum(len(record.constant) for record in (self._points, self._transforms, self._metrics))
        self._max_fixes = max(1, CHUNK_SIZE // tick_size)
        still = scene(header.outline, header.altitude, header.drones, header.radius)
        self._file.add_message(self._channels["/scene"], 0, still.SerializeToString())
        walls = arena_points(header.outline, header.altitude)
        self._file.add_message(self._channels["/arena"], 0, walls.SerializeToString())
        self._file.flush()

    def block(self, block: SampleBlock) -> None:
        """Write K ticks."""
        count = len(block.time_ns)
        if not count:
            return
        for first in range(0, count, self._max_fixes):
            self._ticks(SampleBlock._make(array[first : first + self._max_fixes] for array in block))
        self._flush_in_time(int(block.time_ns[-1]))

    def event(self, event: FlightEvent) -> None:
        """Write an event."""
        self._file.add_message(self._channels["/log"], event.time_ns, event_message(event, self._drones))

    def state(self, state: FlightState) -> None:
        """Write a state to resume from."""
        message = SimState(version=LOG_VERSION, state=state.state)
        self._file.add_message(self._channels["/sim/state"], state.time_ns, message.SerializeToString())

    def packet(self, packet: LinkPacket) -> None:
        """Write a packet of MAVLink."""
        message = Packet(system=packet.system, sent=packet.sent, packet=packet.packet)
        self._file.add_message(self._channels["/mavlink"], packet.time_ns, message.SerializeToString())

    def finish(self, result: Mapping[str, str] | None) -> None:
        """Write the result and the index, all of which is with the operating system afterwards."""
        self._file.flush()
        if result is not None:
            self._file.add_metadata(RESULT_METADATA, result)
        self._file.finish()

    def _ticks(self, block: SampleBlock) -> None:
        """Add K ticks to the chunk: of each the points, perhaps the transforms, and the metrics."""
        time_ns, count, period = block.time_ns, len(block.time_ns), self._transform_period
        ticks = np.arange(self._tick, self._tick + count)
        first_posed = -self._tick % period
        posed = slice(first_posed, None, period)
        self._tick += count
        stamps = timestamps(time_ns)
        points = message_rows(self._points, ticks, time_ns)
        fill_points(points["data"], block, stamps)
        transforms = message_rows(self._transforms, ticks[posed], time_ns[posed])
        fill_transforms(transforms["data"], block.qpos[posed], stamps[posed])
        metrics = message_rows(self._metrics, ticks, time_ns)
        fill_metrics(metrics["data"], block, ticks)
        # Three places for every tick; that of the transforms is mostly left empty.
        records = [b""] * (3 * count)
        places = {
            self._channels["/swarm/points"]: slice(0, None, 3),
            self._channels["/tf"]: slice(3 * first_posed + 1, None, 3 * period),
            self._channels["/metrics"]: slice(2, None, 3),
        }
        for rows, place in zip((points, transforms, metrics), places.values(), strict=True):
            records[place] = row_bytes(rows)
        self._file.add_records(records, time_ns.repeat(3), places)

    def _flush_in_time(self, time_ns: int) -> None:
        """Close the chunk if a program killed before its next block would otherwise lose more than a second.

        What it loses is all that waits in the chunk and the block that it is flying, taken to be as long as the last.
        """
        if (time_ns - self._flushed) + (time_ns - self._written) > _SECOND:
            self._file.flush()
            self._flushed = time_ns
        self._written = time_ns


def event_message(event: FlightEvent, drones: int) -> bytes:
    """An event as `foxglove.Log`."""
    name = "flock" if event.drone < 0 else frame_name(event.drone, drones)
    message = Log(level=Log.Level.Value(event.level.upper()), message=event.message, name=name)
    message.timestamp.seconds, message.timestamp.nanos = divmod(event.time_ns, _SECOND)
    return bytes(message.SerializeToString())


def fill_points(messages: npt.NDArray[Any], block: SampleBlock, stamps: npt.NDArray[np.uint8]) -> None:
    """Fill K messages of `points_record`; stamps: those of the block's ticks, (K, 12)."""
    messages["stamp"] = stamps
    drones = messages["points"]
    # A body that has gone wild may leave what a float of four bytes can hold; that is infinity then.
    with np.errstate(over="ignore"):
        drones["qpos"] = block.qpos
        drones["qvel"] = block.qvel
        drones["desired_velocity"][..., :2] = block.desired_velocity
    drones["rgba"] = STATUS_RGBA[STATUS_ROW[block.status]]
    drones["status"] = block.status


def fill_transforms(messages: npt.NDArray[Any], qpos: npt.NDArray[np.float64], stamps: npt.NDArray[np.uint8]) -> None:
    """Fill K messages of `transforms_record`; qpos: (K, N, 7); stamps: (K, 12)."""
    drones = messages["drones"]
    drones["stamp"] = stamps[:, None]
    drones["translation"]["value"] = qpos[..., :3]
    drones["rotation"]["value"][..., :3] = qpos[..., 4:]
    drones["rotation"]["value"][..., 3] = qpos[..., 3]


def fill_metrics(messages: npt.NDArray[Any], block: SampleBlock, ticks: npt.NDArray[np.int64]) -> None:
    """Fill K messages of `metrics_record`; ticks: their numbers, (K,)."""
    messages["tick"] = varints(ticks)
    values = messages["values"]["value"]
    values[:, : len(ORDER_PARAMETER_FIELDS)] = block.order_parameters
    values[:, len(ORDER_PARAMETER_FIELDS) :] = block.fitness
    messages["digest"] = state_digests(block.qpos, block.qvel)


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
