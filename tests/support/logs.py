"""Logs for tests: written of random samples, changed, damaged, and files that are none."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

import numpy as np
import zstandard
from mcap.reader import make_reader
from mcap.writer import Writer

from moflock_mj.log.chunk_writer import ChunkWriter
from moflock_mj.log.encoder import Attachment, LogHeader, SampleBlock
from moflock_mj.log.schemas import CHANNELS, RUN_COPY, RUN_METADATA, schema_of
from moflock_mj.log.writer import FlightLog
from moflock_mj.metrics.events import FlightEvent

TICK = 100_000_000


def header(drones: int, **changes: object) -> LogHeader:
    settings = {
        "metadata": {"seed": "1"},
        "attachments": (Attachment("scenario.toml", "application/toml", b"drones = 3\n"),),
        "outline": np.array([[-250.0, -250.0], [250.0, -250.0], [250.0, 250.0], [-250.0, 250.0]]),
        "altitude": 10.0,
        "drones": drones,
        "radius": 0.25,
        "transform_period": 5,
    }
    return LogHeader(**(settings | changes))


def some_flight(drones: int, ticks: int, seed: int = 1) -> SampleBlock:
    rng = np.random.default_rng(seed)
    return SampleBlock(
        time_ns=np.arange(1, ticks + 1) * TICK,
        qpos=rng.normal(size=(ticks, drones, 7)),
        qvel=rng.normal(size=(ticks, drones, 6)),
        desired_velocity=rng.normal(size=(ticks, drones, 2)),
        status=rng.integers(0, 4, size=(ticks, drones), dtype=np.uint8),
        order_parameters=rng.random((ticks, 6)),
        fitness=rng.random((ticks, 9)),
    )


def cut(flight: SampleBlock, size: int) -> list[SampleBlock]:
    return [SampleBlock(*(a[i : i + size] for a in flight)) for i in range(0, len(flight.time_ns), size)]


def write_log(path: Path, flight: SampleBlock, block: int = 10, **changes: object) -> Path:
    with FlightLog(path, header(flight.qpos.shape[1], **changes)) as log:
        for part in cut(flight, block):
            log.write(part)
            log.state(int(part.time_ns[-1]), b"state at " + str(part.time_ns[-1]).encode())
        log.event(FlightEvent(int(flight.time_ns[-1]), "warning", "drone 0 left the arena", 0))
        log.finish({"F_1": "0.5"})
    return path


def rebuild(source, target, *, run=None, result=True, change=lambda *m: m):
    """Write a log again, changed: entries of `moflock.run`, and each message (topic, time, data), None to drop it."""
    with source.open("rb") as stream:
        reader = make_reader(stream)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attachments = [(a.name, a.media_type, a.data) for a in reader.iter_attachments()]
        messages = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages(log_time_order=False)]
    entries = {name: text for name, text in (metadata[RUN_METADATA] | (run or {})).items() if text is not None}
    with target.open("wb") as stream:
        writer = ChunkWriter(stream)
        writer.add_metadata(RUN_METADATA, entries)
        for name, media_type, data in attachments:
            writer.add_attachment(name, media_type, json.dumps(entries).encode() if name == RUN_COPY else data)
        numbers = {topic: writer.add_channel(topic, *schema_of(kind)) for topic, kind in CHANNELS.items()}
        for message in messages:
            changed = change(*message)
            if changed:
                writer.add_message(numbers[changed[0]], *changed[1:])
        if result:
            writer.add_metadata("moflock.result", metadata["moflock.result"])
        writer.finish()
    return target


def foreign(path: Path) -> Path:
    """An MCAP file of another program."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("a", "jsonschema", b"{}")
        channel = writer.register_channel("/a", "json", schema)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    return path


def bomb(path: Path, size: int) -> Path:
    """A file whose only chunk unpacks to zeros."""
    packed = zstandard.ZstdCompressor().compress(bytes(size))
    head = struct.pack("<QQQII4sQ", 0, 0, size, zlib.crc32(bytes(size)), 4, b"zstd", len(packed))
    with path.open("wb") as stream:
        writer = ChunkWriter(stream)
        writer.add_metadata(RUN_METADATA, {})
        writer._write(struct.pack("<BQ", 6, len(head) + len(packed)) + head + packed)
        writer.finish()
    return path


def flipped(source: Path, target: Path, position: int) -> Path:
    content = bytearray(source.read_bytes())
    content[position] ^= 4
    target.write_bytes(content)
    return target
