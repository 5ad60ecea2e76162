"""Reads the records of an MCAP file that may be cut off, damaged or hostile; the layout is that of https://mcap.dev/spec.

Nothing that a file says of itself is believed: a length is compared with what there is before anything is read, and a
chunk is unpacked only after its size has been found small enough.
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
"""Bytes of an unpacked chunk; the writer's are about 1 MiB, and the whole state of 10 000 drones takes 10 MB."""

_MAX_GROWTH = 64
"""How many times its own size a file may unpack to in all, beyond the size of one chunk; a log takes twice, if that."""


class DamageError(Exception):
    """What is wrong with a file or one of its records, in a few words."""


class Record(NamedTuple):
    """One record.

    Attributes:
        opcode: what it is.
        content: what follows the opcode and the length.
        end: where the next record begins.
    """

    opcode: int
    content: memoryview
    end: int


class AttachedFile(NamedTuple):
    """A file inside the file."""

    name: str
    media_type: str
    data: bytes


class Message(NamedTuple):
    """A message: its channel's id, its number, its log time in ns, its bytes."""

    channel: int
    sequence: int
    time_ns: int
    data: memoryview


class Summary(NamedTuple):
    """What the end of a finished file says of it: how much there is, and from which to which log time, ns."""

    attachments: int
    metadata: int
    chunks: int
    first_ns: int
    last_ns: int


def map_file(path: Path) -> memoryview:
    """The bytes of a file, which are read from the disk as they are looked at.

    Raises:
        LogError: there is no such file, or it cannot be read.
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
    """The record that begins here.

    Raises:
        DamageError: there is none.
    """
    if position + _PREFIX.size > len(data):
        raise DamageError(f"ends within a record, at byte {len(data)}")
    opcode, length = _PREFIX.unpack_from(data, position)
    start = position + _PREFIX.size
    if not Opcode.HEADER <= opcode <= Opcode.DATA_END:
        raise DamageError(f"byte {position} begins no record")
    if length > len(data) - start:
        raise DamageError(f"ends within the record that begins at byte {position}")
    return Record(opcode, data[start : start + length], start + length)


def records_in(data: memoryview) -> Iterator[Record]:
    """The records that fill a chunk.

    Raises:
        DamageError: they do not.
    """
    position = 0
    while position < len(data):
        record = record_at(data, position)
        position = record.end
        yield record


def read_message(content: memoryview) -> Message:
    """A message record.

    Raises:
        DamageError: it is none.
    """
    if len(content) < _MESSAGE_HEAD.size:
        raise DamageError("a message is cut off")
    channel, sequence, time_ns, _ = _MESSAGE_HEAD.unpack_from(content)
    return Message(channel, sequence, time_ns, content[_MESSAGE_HEAD.size :])


def read_channel(content: memoryview) -> tuple[int, str]:
    """The id and the topic of a channel record.

    Raises:
        DamageError: it is none.
    """
    fields = _Fields(content, "a channel")
    number, _, topic = fields.number(2), fields.number(2), fields.text()
    return number, topic


def check_bookkeeping(record: Record) -> None:
    """Check a record whose content is of no use, but whose length says where the next one begins.

    Raises:
        DamageError: its length does not fit its content.
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
    """The name and the entries of a metadata record.

    Raises:
        DamageError: it is none.
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
    """An attachment whose checksum is right.

    Raises:
        DamageError: it is none.
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
    """Unpacks the chunks of one file, as long as they stay within reason.

    Args:
        file_size: bytes.
    """

    def __init__(self, file_size: int) -> None:
        self._left = _MAX_CHUNK + _MAX_GROWTH * file_size
        self._decompressor = zstandard.ZstdDecompressor()

    def unpack(self, content: memoryview) -> memoryview:
        """The records inside a chunk record whose checksum is right.

        Raises:
            DamageError: it is none, or too large.
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
            if zstandard.frame_content_size(packed) != size:  # what zstandard would set aside, unasked
                raise DamageError("a chunk is of another size than it says")
            records = self._decompressor.decompress(packed)
        except zstandard.ZstdError:
            raise DamageError("a chunk cannot be unpacked") from None
        if zlib.crc32(records) != checksum:
            raise DamageError("the checksum of a chunk is wrong")
        return memoryview(records)


def read_summary(data: memoryview) -> Summary:
    """What the end of a file says of it.

    Raises:
        DamageError: the file has no end, or a damaged one.
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
    raise DamageError("its summary says not how much it holds")


def printable(text: str) -> str:
    """A text of unknown origin, short and without what could upset a terminal."""
    return "".join(sign if sign.isprintable() else "?" for sign in text[:200])


class _Fields:
    """The fields of a record, one after the other."""

    def __init__(self, content: memoryview, what: str) -> None:
        self._content = content
        self._what = what

    @property
    def left(self) -> int:
        """Bytes that are still to be taken."""
        return len(self._content)

    def take(self, size: int) -> memoryview:
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
            raise DamageError(f"{self._what} holds a text that is not UTF-8") from None

    def end(self) -> None:
        if self._content:
            raise DamageError(f"{self._what} is {len(self._content)} bytes too long")
