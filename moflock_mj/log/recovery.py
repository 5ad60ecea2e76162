"""Recovery of a log whose writer was killed, or which is cut off or damaged."""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from moflock_mj.errors import LogError, MoflockError
from moflock_mj.files import make_folder
from moflock_mj.log.chunk_writer import ChunkWriter
from moflock_mj.log.mcap_records import (
    AttachedFile,
    ChunkUnpacker,
    DamageError,
    Message,
    Record,
    check_bookkeeping,
    map_file,
    read_attachment,
    read_message,
    read_metadata,
    read_summary,
    record_at,
    records_in,
)
from moflock_mj.log.reader import LoggedFlight, flight_of, read_content, run_copy
from moflock_mj.log.schemas import CHANNELS, RESULT_METADATA, RUN_METADATA, schema_of

RECOVERY_METADATA = "moflock.recovery"
"""Name of the metadata record about the source and the problems of a recovered log."""

_RECORD_START = re.compile(
    rb"\x06.{36}\x04\0\0\0zstd"  # a chunk
    rb"|\x09.{8}\0{16}"  # an attachment, whose times are zero
    rb"|\x0c.{8}(?:\x0b\0\0\0moflock\.run|\x0e\0\0\0moflock\.result)"
    rb"|\x0f\x04\0{7}",  # the end of the data
    re.DOTALL,
)
"""Pattern of the beginning of records to search for after a damaged one."""

_MAX_SEARCHED = 16
"""Largest ratio of bytes read in damaged records to the file size, which bounds the time for a hostile file."""

_MAX_PROBLEMS = 20


@dataclasses.dataclass(frozen=True, kw_only=True)
class Recovery:
    """Result of a recovery.

    Attributes:
        broken: path of the damaged file.
        log: path of the recovered log.
        start: time of the beginning of the log, s; 0 unless the flight was resumed.
        end: time of the last recovered sample, s.
        kept: simulated time with samples in the recovered log, s.
        lost: simulated time that is known to be missing, s.
        end_known: True if `lost` includes the missing time at the end. Otherwise the end is unknown; a killed writer
            loses at most the last simulated second.
        duration: duration of the scenario, s.
        messages: number of messages in the recovered log.
        problems: problems of the file; empty if it is intact.
    """

    broken: Path
    log: Path
    start: float
    end: float
    kept: float
    lost: float
    end_known: bool
    duration: float
    messages: int
    problems: tuple[str, ...]


def recovered_path(broken: str | Path) -> Path:
    """Default path of a recovered log, beside the damaged one."""
    broken = Path(broken)
    name = broken.name.removesuffix(".part").removesuffix(".mcap")
    plain = broken.with_name(f"{name}.mcap")
    return broken.with_name(f"{name}.recovered.mcap") if plain.exists() else plain


def recover(
    broken: str | Path, out: str | Path | None = None, progress: Callable[[float], None] | None = None
) -> Recovery:
    """Write a complete log of the intact records of a damaged one.

    Args:
        broken: path of the damaged file, which is not changed.
        out: path of the recovered log; `recovered_path` if absent.
        progress: callback with the completed fraction, up to 1.

    Raises:
        LogError: no flight can be recovered, or the new log cannot be written.
    """
    broken = Path(broken)
    data = map_file(broken)
    out = recovered_path(broken) if out is None else Path(out)
    if out.resolve() == broken.resolve():
        raise LogError(f"log: {out}: is the broken log; the recovered one must be another file")
    _refuse_unfinished_flight(broken)
    salvage = _Salvage(data, progress or (lambda _: None))
    if RUN_METADATA not in salvage.metadata:
        raise LogError(f"log: {broken}: no record {RUN_METADATA} is intact: the inputs of the flight are unknown")
    with _replacing(out) as part:
        try:
            with part.open("wb") as stream:
                messages = salvage.write(stream, broken.name)
            flight = flight_of(out, read_content(map_file(part)))
        except (DamageError, MoflockError) as problem:
            raise LogError(f"log: {broken}: the intact records are not a flight: {problem}") from None
    known_end = salvage.known_end()
    return _recovery(flight, broken, messages, known_end, tuple(salvage.problems))


class _Salvage:
    """Intact content of a file.

    Args:
        data: content of the file.
        progress: callback with the completed fraction.

    Attributes:
        metadata: metadata records by name.
        attachments: attachments with correct checksums.
        problems: problems, in the order of the file.
    """

    def __init__(self, data: memoryview, progress: Callable[[float], None]) -> None:
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, AttachedFile] = {}
        self.problems: list[str] = []
        self._data = data
        self._progress = progress
        self._chunks: list[Record] = []
        self._ended = False
        self._unpacker = ChunkUnpacker(len(data))
        position = 0 if data[: len(MCAP0_MAGIC)] != MCAP0_MAGIC else len(MCAP0_MAGIC)
        if not position:
            self._note("does not begin as an MCAP file")
        for record in self._intact_records(position):
            progress(record.end / len(data) / 2)
        if not self._ended:
            self._note("has no end")
        self._restore_run()

    def write(self, stream: IO[bytes], origin: str) -> int:
        """Write the intact records as a complete log, and return the number of messages.

        Args:
            stream: stream of the recovered log.
            origin: name of the damaged file.
        """
        writer, unpacker, messages = ChunkWriter(stream), ChunkUnpacker(len(self._data)), 0
        self.metadata[RECOVERY_METADATA] = {"from": origin, "problems": "; ".join(self.problems)}
        writer.add_metadata(RUN_METADATA, self.metadata[RUN_METADATA])
        for attachment in self.attachments.values():
            writer.add_attachment(*attachment)
        # Only the first chunk has schemas and channels, and it may be lost; they are the same in every log.
        for topic, message in CHANNELS.items():
            writer.add_channel(topic, *schema_of(message))
        for chunk in self._chunks:
            for message in _messages(unpacker.unpack(chunk.content)):
                writer.add_message(message.channel, message.time_ns, bytes(message.data), message.sequence)
                messages += 1
            writer.flush()
            self._progress((1 + chunk.end / len(self._data)) / 2)
        for name, entries in self.metadata.items():
            if name != RUN_METADATA:
                writer.add_metadata(name, entries)
        writer.finish()
        return messages

    def known_end(self) -> float | None:
        """Time of the end of the flight, s; None if it is unknown."""
        with contextlib.suppress(KeyError, ValueError):
            return float(self.metadata[RESULT_METADATA]["flown"])
        with contextlib.suppress(DamageError):
            return read_summary(self._data).last_ns / 1e9
        return None

    def _intact_records(self, position: int) -> Iterator[Record]:
        """Store and iterate over the intact records, up to the end of the data."""
        budget = _MAX_SEARCHED * len(self._data)
        while not self._ended and position < len(self._data):
            length = 0
            try:
                record = record_at(self._data, position)
                length = len(record.content)
                self._store(record)
            except DamageError as problem:
                self._note(f"byte {position}: {problem}")
                budget -= length
                record_start = _RECORD_START.search(self._data, position + 1)
                if record_start is None or budget < 0:
                    return
                position = record_start.start()
            else:
                position = record.end
                yield record

    def _store(self, record: Record) -> None:
        """Store a record.

        Raises:
            DamageError: the record is not intact.
        """
        match record.opcode:
            case Opcode.METADATA:
                name, entries = read_metadata(record.content)
                self.metadata[name] = entries
            case Opcode.ATTACHMENT:
                attachment = read_attachment(record.content)
                self.attachments[attachment.name] = attachment
            case Opcode.CHUNK:
                list(_messages(self._unpacker.unpack(record.content)))  # check that all messages can be read
                self._chunks.append(record)
            case Opcode.HEADER | Opcode.MESSAGE_INDEX | Opcode.DATA_END:
                check_bookkeeping(record)
                self._ended = record.opcode == Opcode.DATA_END
            case _:
                raise DamageError("a record of an unexpected kind")

    def _restore_run(self) -> None:
        """Restore the record `moflock.run` from its copy, which has a checksum."""
        copied = run_copy({name: attachment.data for name, attachment in self.attachments.items()})
        if copied and copied != self.metadata.get(RUN_METADATA):
            self._note(f"the record {RUN_METADATA} is damaged; its copy is intact")
            self.metadata[RUN_METADATA] = copied

    def _note(self, problem: str) -> None:
        if len(self.problems) < _MAX_PROBLEMS:
            self.problems.append(problem)


def _messages(chunk: memoryview) -> Iterator[Message]:
    """Messages of a chunk on the channels of a log.

    Raises:
        DamageError: the chunk does not consist of complete records.
    """
    for record in records_in(chunk):
        if record.opcode == Opcode.MESSAGE:
            message = read_message(record.content)
            if 1 <= message.channel <= len(CHANNELS):
                yield message


def _recovery(
    flight: LoggedFlight, broken: Path, messages: int, known_end: float | None, problems: tuple[str, ...]
) -> Recovery:
    """Create the result from a recovered flight."""
    end = float(flight.samples.t[-1])
    # A flight that ended with an error has not logged its last samples.
    last = end if known_end is None or "error" in flight.result else min(known_end, flight.scenario.duration)
    return Recovery(
        broken=broken,
        log=flight.log,
        start=flight.start,
        end=end,
        kept=round(end - flight.start - flight.missing, 9),
        lost=round(flight.missing + max(last - end, 0.0), 9),
        end_known=known_end is not None,
        duration=flight.scenario.duration,
        messages=messages,
        problems=problems,
    )


@contextlib.contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path, and rename it to `path` on success or remove it on failure.

    Raises:
        LogError: the file cannot be written.
    """
    part = path.with_name(f"{path.name}.recovered.part")
    try:
        make_folder(path)
        yield part
        part.replace(path)
    except OSError as problem:
        reason = problem.strerror or str(problem)
        raise LogError(f"log: {path}: {reason[:1].lower()}{reason[1:]}") from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def _refuse_unfinished_flight(path: Path) -> None:
    """Refuse a log that is still being written.

    Raises:
        LogError: a flight holds the lock of the file.
    """
    with path.open("rb") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise LogError(f"log: {path}: a flight is writing it") from None
