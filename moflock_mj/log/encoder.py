"""Encoder of samples, events and states of a flight as messages of an MCAP stream."""

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
    """K consecutive samples. The log keeps the arrays, and the caller must not change them afterwards.

    Attributes:
        time_ns: (K,), int64, simulated time, ns.
        qpos: (K, N, 7), position (m, world) and quaternion wxyz.
        qvel: (K, N, 6), velocity (m/s, world) and body rates (rad/s, body).
        desired_velocity: (K, N, 2), horizontal velocity command, m/s, world.
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
    """File attached to a log."""

    name: str
    media_type: str
    data: bytes


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class LogHeader:
    """Content of a log before the first sample.

    Attributes:
        metadata: entries of the record `moflock.run`, without `log_version`.
        attachments: model, scenario, parameters, and viewer layouts.
        outline: (M, 2), corners of the arena's wall in order, m, world.
        altitude: flight altitude, m.
        drones: number of drones, N.
        radius: radius of one drone, m.
        transform_period: samples between two messages on /tf; viewers interpolate between them.
    """

    metadata: Mapping[str, str]
    attachments: tuple[Attachment, ...]
    outline: npt.NDArray[np.float64]
    altitude: float
    drones: int
    radius: float
    transform_period: int = 5


class FlightState(NamedTuple):
    """Complete state of a flight as bytes, and its simulated time, ns."""

    time_ns: int
    state: bytes


class LinkPacket(NamedTuple):
    """MAVLink packet on a link.

    Attributes:
        time_ns: time of the packet, ns.
        system: system id of the vehicle; 0 for all on the link.
        sent: True if the packet was sent to the vehicle, False if it was received.
        packet: bytes of the packet.
    """

    time_ns: int
    system: int
    sent: bool
    packet: bytes


class Encoder:
    """Encoder of blocks, events and states as messages of an MCAP stream."""

    def __init__(self, stream: IO[bytes], header: LogHeader) -> None:
        self._file = ChunkWriter(stream)
        self._drones = header.drones
        self._transform_period = header.transform_period
        self._tick = 0
        self._written = 0  # simulated time of the last sample, and of the last one passed to the operating system, ns
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
        # A block longer than a chunk is divided.
        sample_size = sum(len(record.constant) for record in (self._points, self._transforms, self._metrics))
        self._max_samples = max(1, CHUNK_SIZE // sample_size)
        static_scene = scene(header.outline, header.altitude, header.drones, header.radius)
        self._file.add_message(self._channels["/scene"], 0, static_scene.SerializeToString())
        walls = arena_points(header.outline, header.altitude)
        self._file.add_message(self._channels["/arena"], 0, walls.SerializeToString())
        self._file.flush()

    def block(self, block: SampleBlock) -> None:
        """Write K samples."""
        count = len(block.time_ns)
        if not count:
            return
        for first in range(0, count, self._max_samples):
            self._samples(SampleBlock._make(array[first : first + self._max_samples] for array in block))
        self._flush_in_time(int(block.time_ns[-1]))

    def event(self, event: FlightEvent) -> None:
        """Write an event."""
        self._file.add_message(self._channels["/log"], event.time_ns, event_message(event, self._drones))

    def state(self, state: FlightState) -> None:
        """Write a complete state."""
        message = SimState(version=LOG_VERSION, state=state.state)
        self._file.add_message(self._channels["/sim/state"], state.time_ns, message.SerializeToString())

    def packet(self, packet: LinkPacket) -> None:
        """Write a MAVLink packet."""
        message = Packet(system=packet.system, sent=packet.sent, packet=packet.packet)
        self._file.add_message(self._channels["/mavlink"], packet.time_ns, message.SerializeToString())

    def finish(self, result: Mapping[str, str] | None) -> None:
        """Write result and index, and pass all bytes to the operating system."""
        self._file.flush()
        if result is not None:
            self._file.add_metadata(RESULT_METADATA, result)
        self._file.finish()

    def _samples(self, block: SampleBlock) -> None:
        """Add K samples to the chunk: points, transforms of every `transform_period`-th sample, and metrics."""
        time_ns, count, period = block.time_ns, len(block.time_ns), self._transform_period
        numbers = np.arange(self._tick, self._tick + count)
        first_transform = -self._tick % period
        with_transforms = slice(first_transform, None, period)
        self._tick += count
        stamps = timestamps(time_ns)
        points = message_rows(self._points, numbers, time_ns)
        fill_points(points["data"], block, stamps)
        transforms = message_rows(self._transforms, numbers[with_transforms], time_ns[with_transforms])
        fill_transforms(transforms["data"], block.qpos[with_transforms], stamps[with_transforms])
        metrics = message_rows(self._metrics, numbers, time_ns)
        fill_metrics(metrics["data"], block, numbers)
        # Three slots for each sample; that of the transforms is mostly empty.
        records = [b""] * (3 * count)
        slots = {
            self._channels["/swarm/points"]: slice(0, None, 3),
            self._channels["/tf"]: slice(3 * first_transform + 1, None, 3 * period),
            self._channels["/metrics"]: slice(2, None, 3),
        }
        for rows, slot in zip((points, transforms, metrics), slots.values(), strict=True):
            records[slot] = row_bytes(rows)
        self._file.add_records(records, time_ns.repeat(3), slots)

    def _flush_in_time(self, time_ns: int) -> None:
        """Close the chunk if a program killed before its next block would otherwise lose more than a second.

        The loss is the content of the open chunk and the next block, which is assumed to be as long as the last one.
        """
        if (time_ns - self._flushed) + (time_ns - self._written) > _SECOND:
            self._file.flush()
            self._flushed = time_ns
        self._written = time_ns


def event_message(event: FlightEvent, drones: int) -> bytes:
    """Encode an event as `foxglove.Log`."""
    name = "flock" if event.drone < 0 else frame_name(event.drone, drones)
    message = Log(level=Log.Level.Value(event.level.upper()), message=event.message, name=name)
    message.timestamp.seconds, message.timestamp.nanos = divmod(event.time_ns, _SECOND)
    return bytes(message.SerializeToString())


def fill_points(messages: npt.NDArray[Any], block: SampleBlock, stamps: npt.NDArray[np.uint8]) -> None:
    """Fill K messages of `points_record`; stamps: times of the samples, (K, 12)."""
    messages["stamp"] = stamps
    drones = messages["points"]
    # Values of a diverged body beyond the range of a 4-byte float become infinity.
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


def fill_metrics(messages: npt.NDArray[Any], block: SampleBlock, numbers: npt.NDArray[np.int64]) -> None:
    """Fill K messages of `metrics_record`; numbers: numbers of the samples, (K,)."""
    messages["tick"] = varints(numbers)
    values = messages["values"]["value"]
    values[:, : len(ORDER_PARAMETER_FIELDS)] = block.order_parameters
    values[:, len(ORDER_PARAMETER_FIELDS) :] = block.fitness
    messages["digest"] = state_digests(block.qpos, block.qvel)


def check_shapes(block: SampleBlock, drones: int) -> None:
    """Check the shapes of a block's arrays.

    Raises:
        ValueError: an array has another shape than expected.
    """
    samples = len(block.time_ns)
    shapes = {
        "time_ns": (samples,),
        "qpos": (samples, drones, 7),
        "qvel": (samples, drones, 6),
        "desired_velocity": (samples, drones, 2),
        "status": (samples, drones),
        "order_parameters": (samples, len(ORDER_PARAMETER_FIELDS)),
        "fitness": (samples, len(FITNESS_FIELDS)),
    }
    for name, shape in shapes.items():
        if getattr(block, name).shape != shape:
            raise ValueError(f"{name}: shape {getattr(block, name).shape} given, {shape} expected")
