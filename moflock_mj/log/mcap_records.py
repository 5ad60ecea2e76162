"""Reader of the records of an MCAP file that may be cut off, damaged or hostile.

The layout is that of https://mcap.dev/spec. The reader does not trust the file: it checks every length against the
available bytes, and the size of a chunk against a limit before decompression.
"""

from __future__ import annotations

import mmap
import stat
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from moflock_mj.errors import LogError

_PREFIX = struct.Struct("<BQ")  # opcode, length of the content
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_FOOTER = struct.Struct("<BQQQI8s")  # opcode, length, summary start, start of its offsets, checksum, magic
_STATISTICS = struct.Struct("<QHIIII")  # messages, schemas, channels, attachments, metadata, chunks

_MAX_CHUNK = 1 << 26
"""Largest size of a decompressed chunk, bytes; usual ones have 1 MiB, and a state of 10 000 drones takes 10 MB."""

_MAX_GROWTH = 64
"""Largest ratio of decompressed to compressed size of a file, besides one chunk; that of a log is at most about 2."""


class DamageError(Exception):
    """Damage of a file or of one of its records, described in a few words."""


class Record(NamedTuple):
    """Record of an MCAP file.

    Attributes:
        opcode: kind of the record.
        content: bytes after opcode and length.
        end: position of the next record.
    """

    opcode: int
    content: memoryview
    end: int


class AttachedFile(NamedTuple):
    """File attached to an MCAP file."""

    name: str
    media_type: str
    data: bytes


class Message(NamedTuple):
    """Message: id of its channel, sequence number, log time (ns) and bytes."""

    channel: int
    sequence: int
    time_ns: int
    data: memoryview


class Summary(NamedTuple):
    """Summary of a complete file: numbers of records, and range of log times, ns."""

    attachments: int
    metadata: int
    chunks: int
    first_ns: int
    last_ns: int


def map_file(path: Path) -> memoryview:
    """Map a file into memory.

    Raises:
        LogError: the file does not exist, is empty, or cannot be read.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise LogError(f"log: {path}: is not a file")
        with path.open("rb") as stream:
            if not path.stat().st_size:
                raise LogError(f"log: {path}: is empty")
            return memoryview(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ))
    except (OSError, ValueError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else str(problem)
        raise LogError(f"log: {path}: {(reason or str(problem)).lower()}") from None


def record_at(data: memoryview, position: int) -> Record:
    """Record at a position.

    Raises:
        DamageError: no complete record begins there.
    """
    if position + _PREFIX.size > len(data):
        raise DamageError(f"ends within a record, at byte {len(data)}")
    opcode, length = _PREFIX.unpack_from(data, position)
    start = position + _PREFIX.size
    if not Opcode.HEADER <= opcode <= Opcode.DATA_END:
        raise DamageError(f"byte {position} does not begin a record")
    if length > len(data) - start:
        raise DamageError(f"ends within the record that begins at byte {position}")
    return Record(opcode, data[start : start + length], start + length)


def records_in(data: memoryview) -> Iterator[Record]:
    """Iterate over the records of a chunk.

    Raises:
        DamageError: the chunk does not consist of complete records.
    """
    position = 0
    while position < len(data):
        record = record_at(data, position)
        position = record.end
        yield record


def read_message(content: memoryview) -> Message:
    """Decode a message record.

    Raises:
        DamageError: the record is invalid.
    """
    if len(content) < _MESSAGE_HEAD.size:
        raise DamageError("a message is cut off")
    channel, sequence, time_ns, _ = _MESSAGE_HEAD.unpack_from(content)
    return Message(channel, sequence, time_ns, content[_MESSAGE_HEAD.size :])


def read_channel(content: memoryview) -> tuple[int, str]:
    """Id and topic of a channel record.

    Raises:
        DamageError: the record is invalid.
    """
    fields = _Fields(content, "a channel")
    number, _, topic = fields.number(2), fields.number(2), fields.text()
    return number, topic


def check_bookkeeping(record: Record) -> None:
    """Check the length of a record whose content is not used.

    Raises:
        DamageError: the length does not match the content.
    """
    fields = _Fields(record.content, "a record")
    match record.opcode:
        case Opcode.HEADER:
            fields.text(), fields.text()
        case Opcode.MESSAGE_INDEX:
            fields.take(2)
            fields.take(fields.number(4))
        case Opcode.DATA_END:
            fields.take(4)
    fields.end()


def read_metadata(content: memoryview) -> tuple[str, dict[str, str]]:
    """Name and entries of a metadata record.

    Raises:
        DamageError: the record is invalid.
    """
    fields = _Fields(content, "a metadata record")
    name = fields.text()
    entries = _Fields(fields.take(fields.number(4)), "a metadata record")
    fields.end()
    values = {}
    while entries.left:
        key = entries.text()
        values[key] = entries.text()
    return name, values


def read_attachment(content: memoryview) -> AttachedFile:
    """Decode an attachment and verify its checksum.

    Raises:
        DamageError: the record is invalid, or its checksum is wrong.
    """
    fields = _Fields(content, "an attachment")
    fields.take(16)  # two times, both zero
    name, media_type = fields.text(), fields.text()
    data = fields.take(fields.number(8))
    checksum = fields.number(4)
    fields.end()
    if zlib.crc32(content[:-4]) != checksum:
        raise DamageError(f"the checksum of the attachment {printable(name)} is wrong")
    return AttachedFile(name, media_type, bytes(data))


class ChunkUnpacker:
    """Decompressor of the chunks of one file, with a limit on their total size.

    Args:
        file_size: size of the file, bytes.
    """

    def __init__(self, file_size: int) -> None:
        self._left = _MAX_CHUNK + _MAX_GROWTH * file_size
        self._decompressor = zstandard.ZstdDecompressor()

    def unpack(self, content: memoryview) -> memoryview:
        """Decompress the records in a chunk record and verify the checksum.

        Raises:
            DamageError: the record is invalid or too large, or its checksum is wrong.
        """
        fields = _Fields(content, "a chunk")
        fields.take(16)  # its first and its last log time
        size, checksum, compression = fields.number(8), fields.number(4), fields.text()
        packed = fields.take(fields.number(8))
        fields.end()
        if compression != "zstd":
            raise DamageError(f"a chunk is packed by {printable(compression)!r}; it must be zstd")
        if size > _MAX_CHUNK:
            raise DamageError(f"a chunk unpacks to {size} bytes; it must be at most {_MAX_CHUNK}")
        if size > self._left:
            raise DamageError(f"its chunks unpack to over {_MAX_GROWTH} times its size")
        self._left -= size
        try:
            if zstandard.frame_content_size(packed) != size:  # zstandard allocates this size
                raise DamageError("the size of a chunk is not the stated one")
            records = self._decompressor.decompress(packed)
        except zstandard.ZstdError:
            raise DamageError("a chunk cannot be unpacked") from None
        if zlib.crc32(records) != checksum:
            raise DamageError("the checksum of a chunk is wrong")
        return memoryview(records)


def read_summary(data: memoryview) -> Summary:
    """Decode the summary at the end of a file.

    Raises:
        DamageError: the end of the file is missing or damaged.
    """
    start_of_footer = len(data) - _FOOTER.size
    if start_of_footer < 0 or data[-len(MCAP0_MAGIC) :] != MCAP0_MAGIC:
        raise DamageError("is unfinished or cut off")
    opcode, length, start, _, checksum, _ = _FOOTER.unpack_from(data, start_of_footer)
    if opcode != Opcode.FOOTER or length != _FOOTER.size - _PREFIX.size - len(MCAP0_MAGIC):
        raise DamageError("its footer is damaged")
    if not 0 < start <= start_of_footer or zlib.crc32(data[start:-12]) != checksum:
        raise DamageError("the checksum of its summary is wrong")
    for record in records_in(data[start:start_of_footer]):
        if record.opcode == Opcode.STATISTICS:
            fields = _Fields(record.content, "its summary")
            _, _, _, attachments, metadata, chunks = _STATISTICS.unpack(fields.take(_STATISTICS.size))
            return Summary(attachments, metadata, chunks, fields.number(8), fields.number(8))
    raise DamageError("its summary has no statistics")


def printable(text: str) -> str:
    """Shorten an untrusted text, and replace its control characters."""
    return "".join(sign if sign.isprintable() else "?" for sign in text[:200])


class _Fields:
    """Sequential decoder of the fields of a record."""

    def __init__(self, content: memoryview, what: str) -> None:
        self._content = content
        self._what = what

    @property
    def left(self) -> int:
        """Number of remaining bytes."""
        return len(self._content)

    def take(self, size: int) -> memoryview:
        """Next `size` bytes."""
        if size > len(self._content):
            raise DamageError(f"{self._what} is cut off")
        taken, self._content = self._content[:size], self._content[size:]
        return taken

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        try:
            return str(self.take(self.number(4)), "utf-8")
        except UnicodeDecodeError:
            raise DamageError(f"{self._what} contains a text that is not UTF-8") from None

    def end(self) -> None:
        if self._content:
            raise DamageError(f"{self._what} is {len(self._content)} bytes too long")
