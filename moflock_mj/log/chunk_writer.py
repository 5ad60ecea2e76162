"""Writer of MCAP files for batches of encoded messages.

The writer of the `mcap` package handles messages one by one, which costs more than the rest of logging. This writer
builds chunks from complete message records, and their indexes from arrays. The record classes of `mcap` encode all
records that occur once. The layout is that of https://mcap.dev/spec.
"""

from __future__ import annotations

import itertools
import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import IO, Any

import numpy as np
import numpy.typing as npt
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import MCAP0_MAGIC

from moflock_mj.log.schemas import WireRecord

CHUNK_SIZE = 1 << 20  # bytes

# Most of a log is noise in the last bits of floats. On a flight of 30 drones, level 1 saves 3 % of the file in 1.5
# times the time, and level 3 another 0.5 % in more than twice the time.
_ZSTD, _ZSTD_LEVEL = b"zstd", -1
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length of the rest, channel, sequence, log time, publish time
_MESSAGE_FIELDS = [("head", "V11"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")]
_CHUNK = struct.Struct("<BQQQQII4sQ")  # opcode, length of the rest, times, size and checksum, "zstd", compressed size
_MESSAGE_INDEX = struct.Struct("<BQHI")  # opcode, length of the rest, channel, length of the entries
_INDEX_ENTRY = struct.Struct("<QQ")  # log time, offset in the chunk
_PREFIX = 9  # an opcode and a length, which the length does not count


def message_record(channel: int, message: WireRecord) -> WireRecord:
    """Layout of a message record: the fields `sequence`, `log_time`, `publish_time`, and the message in `data`."""
    head = _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE.size - _PREFIX + len(message.constant), channel, 0, 0, 0)
    return WireRecord(np.dtype([*_MESSAGE_FIELDS, ("data", message.dtype)]), head + message.constant)


def message_rows(
    record: WireRecord, sequence: npt.NDArray[np.int64], time_ns: npt.NDArray[np.int64]
) -> npt.NDArray[Any]:
    """Create K message records with empty `data`.

    Args:
        record: layout from `message_record`.
        sequence: (K,), message numbers.
        time_ns: (K,), log times.
    """
    rows = record.rows(len(time_ns))
    rows["sequence"] = sequence
    rows["log_time"] = rows["publish_time"] = time_ns
    return rows


def row_bytes(rows: npt.NDArray[Any]) -> list[bytes]:
    """Bytes of each row."""
    separate: list[bytes] = rows.view(f"V{rows.itemsize}").tolist()
    return separate


class ChunkWriter:
    """Writer of an MCAP file; does not close its stream."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._position = 0
        self._compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._message_counts: dict[int, int] = defaultdict(int)
        self._open = _OpenChunk()
        self._write(MCAP0_MAGIC + _encoded(Header(profile="", library="moflock-mj")))

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Write a metadata record, before the open chunk."""
        record = _encoded(Metadata(name=name, metadata=dict(data)))
        self._metadata.append(MetadataIndex(offset=self._position, length=len(record), name=name))
        self._write(record)

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment, before the open chunk."""
        attachment = Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)
        record = _encoded(attachment)
        self._attachments.append(
            AttachmentIndex(
                offset=self._position,
                length=len(record),
                log_time=attachment.log_time,
                create_time=attachment.create_time,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )
        self._write(record)

    def add_channel(self, topic: str, schema_name: str, descriptors: bytes) -> int:
        """Declare a channel of protobuf messages and their schema, and return its id, from 1."""
        number = len(self._channels) + 1
        schema = Schema(id=number, name=schema_name, encoding=SchemaEncoding.Protobuf, data=descriptors)
        channel = Channel(
            id=number, topic=topic, message_encoding=MessageEncoding.Protobuf, metadata={}, schema_id=number
        )
        self._schemas.append(schema)
        self._channels.append(channel)
        self._open.append(_encoded(schema, channel))
        return number

    def add_message(self, channel: int, time_ns: int, data: bytes, sequence: int = 0) -> None:
        """Add a message to the open chunk."""
        head = _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE.size - _PREFIX + len(data), channel, sequence, time_ns, time_ns)
        self._open.entries[channel].append(_INDEX_ENTRY.pack(time_ns, self._open.size))
        self._open.reach(time_ns)
        self._open.append(head + data)
        self._close_if_full()

    def add_records(self, records: list[bytes], time_ns: npt.NDArray[np.int64], channels: Mapping[int, slice]) -> None:
        """Add many messages to the open chunk.

        Args:
            records: complete message records.
            time_ns: (len(records),), non-decreasing log times, ns.
            channels: slice of the records of each channel.
        """
        *offsets, _ = itertools.accumulate(map(len, records), initial=self._open.size)
        entries = np.empty((len(records), 2), "<u8")
        entries[:, 0] = time_ns
        entries[:, 1] = offsets
        for channel, places in channels.items():
            if len(part := entries[places]):
                self._open.entries[channel].append(part.tobytes())
        self._open.reach(int(time_ns[0]))
        self._open.reach(int(time_ns[-1]))
        self._open.append(b"".join(records))
        self._close_if_full()

    def flush(self) -> None:
        """Close the chunk, unless it is empty, and pass all bytes to the operating system."""
        self._close_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the summary at the end of the file."""
        self._close_chunk()
        self._write(_encoded(DataEnd(data_section_crc=0)))
        self._write(self._summary())
        self._stream.flush()

    def _write(self, data: bytes) -> None:
        self._stream.write(data)
        self._position += len(data)

    def _close_if_full(self) -> None:
        if self._open.size > CHUNK_SIZE:
            self._close_chunk()

    def _close_chunk(self) -> None:
        closing = self._open
        if not closing.entries:
            return
        self._open = _OpenChunk()
        content = b"".join(closing.records)
        data = self._compressor.compress(content)
        length = _CHUNK.size + len(data)
        sizes = (len(content), zlib.crc32(content), len(_ZSTD), _ZSTD, len(data))
        head = _CHUNK.pack(Opcode.CHUNK, length - _PREFIX, closing.start, closing.end, *sizes)
        index, places = b"", {}
        for channel, parts in closing.entries.items():
            places[channel] = self._position + length + len(index)
            index += _message_index(channel, b"".join(parts))
            self._message_counts[channel] += sum(map(len, parts)) // _INDEX_ENTRY.size
        self._chunks.append(
            ChunkIndex(
                chunk_start_offset=self._position,
                chunk_length=length,
                compression=_ZSTD.decode(),
                compressed_size=len(data),
                uncompressed_size=len(content),
                message_start_time=closing.start,
                message_end_time=closing.end,
                message_index_offsets=places,
                message_index_length=len(index),
            )
        )
        self._write(head + data + index)

    def _statistics(self) -> Statistics:
        return Statistics(
            message_count=sum(self._message_counts.values()),
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=len(self._attachments),
            metadata_count=len(self._metadata),
            chunk_count=len(self._chunks),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            channel_message_counts=self._message_counts,
        )

    def _summary(self) -> bytes:
        """Index records, footer and magic bytes."""
        groups: dict[Opcode, Sequence[McapRecord]] = {
            Opcode.SCHEMA: self._schemas,
            Opcode.CHANNEL: self._channels,
            Opcode.STATISTICS: [self._statistics()],
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.ATTACHMENT_INDEX: self._attachments,
            Opcode.METADATA_INDEX: self._metadata,
        }
        start, summary, offsets = self._position, b"", []
        for opcode, records in groups.items():
            group = _encoded(*records)
            offsets.append(
                SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(group))
            )
            summary += group
        footer = Footer(summary_start=start, summary_offset_start=start + len(summary), summary_crc=0)
        summary += _encoded(*offsets)
        # The checksum includes the footer up to the checksum field itself.
        footer.summary_crc = zlib.crc32(summary + _encoded(footer)[:-4])
        return summary + _encoded(footer) + MCAP0_MAGIC


class _OpenChunk:
    """Records of the chunk that is not yet written."""

    def __init__(self) -> None:
        self.records: list[bytes] = []
        self.size = 0
        self.entries: dict[int, list[bytes]] = defaultdict(list)  # by channel, of the message indexes
        self.start, self.end = 2**64 - 1, 0  # log times, ns

    def append(self, records: bytes) -> None:
        self.records.append(records)
        self.size += len(records)

    def reach(self, time_ns: int) -> None:
        """Extend the time range of the chunk to this time."""
        self.start, self.end = min(self.start, time_ns), max(self.end, time_ns)


def _message_index(channel: int, entries: bytes) -> bytes:
    rest = _MESSAGE_INDEX.size - _PREFIX + len(entries)
    return _MESSAGE_INDEX.pack(Opcode.MESSAGE_INDEX, rest, channel, len(entries)) + entries


def _encoded(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    encoded: bytes = builder.end()  # type: ignore[no-untyped-call]
    return encoded
