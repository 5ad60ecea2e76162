"""Saves what is intact of a log whose writer was killed, or which was cut off or damaged."""

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
"""Record of a recovered log: from which file, and what was wrong with it."""

_LANDMARK = re.compile(
    rb"\x06.{36}\x04\0\0\0zstd"  # a chunk
    rb"|\x09.{8}\0{16}"  # an attachment, whose times are zero
    rb"|\x0c.{8}(?:\x0b\0\0\0moflock\.run|\x0e\0\0\0moflock\.result)"
    rb"|\x0f\x04\0{7}",  # the end of the data
    re.DOTALL,
)
"""How the records begin that are worth finding behind a damaged one."""

_MAX_SEARCHED = 16
"""How many times its own size a file is read in vain; one that was made to be slow ends there."""

_MAX_PROBLEMS = 20


@dataclasses.dataclass(frozen=True, kw_only=True)
class Recovery:
    """What was saved of a log, and what was not.

    Attributes:
        broken: the file that was read.
        log: the finished log that was written.
        start: s, where the log begins; 0 unless it was resumed.
        end: s, time of the last sample kept.
        kept: s, simulated time whose samples are in the new log.
        lost: s, simulated time that is known to be missing.
        end_known: whether `lost` counts what is missing at the end, too. If not, the file does not tell; a writer that
            was killed loses at most the last simulated second.
        duration: s, of the scenario.
        messages: how many are in the new log.
        problems: what was wrong with the file; nothing if it was sound.
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
    """Where a recovered log goes unless the user says: beside the broken one, which stays."""
    broken = Path(broken)
    name = broken.name.removesuffix(".part").removesuffix(".mcap")
    plain = broken.with_name(f"{name}.mcap")
    return broken.with_name(f"{name}.recovered.mcap") if plain.exists() else plain


def recover(
    broken: str | Path, out: str | Path | None = None, progress: Callable[[float], None] | None = None
) -> Recovery:
    """Write a finished log of all that is intact in a broken one.

    Args:
        broken: the file to save; it stays as it is.
        out: the log to be written; `recovered_path` if absent.
        progress: told the share that is done, up to 1.

    Raises:
        LogError: no flight is intact, or the new log cannot be written.
    """
    broken = Path(broken)
    data = map_file(broken)
    out = recovered_path(broken) if out is None else Path(out)
    if out.resolve() == broken.resolve():
        raise LogError(f"log: {out}: is the broken log; the recovered one must be another file")
    _refuse_unfinished_flight(broken)
    salvage = _Salvage(data, progress or (lambda _: None))
    if RUN_METADATA not in salvage.metadata:
        raise LogError(f"log: {broken}: no record {RUN_METADATA} is intact: nothing says what was flown")
    with _replacing(out) as part:
        try:
            with part.open("wb") as stream:
                messages = salvage.write(stream, broken.name)
            flight = flight_of(out, read_content(map_file(part)))
        except (DamageError, MoflockError) as problem:
            raise LogError(f"log: {broken}: what is intact makes no flight: {problem}") from None
    known_end = salvage.known_end()
    return _recovery(flight, broken, messages, known_end, tuple(salvage.problems))


class _Salvage:
    """What is intact of a file.

    Args:
        data: the file.
        progress: told the share that is done.

    Attributes:
        metadata: records by name.
        attachments: those whose checksum is right.
        problems: what was wrong, in the order of the file.
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
        self._mend_run()

    def write(self, stream: IO[bytes], origin: str) -> int:
        """Write all that is intact as a finished log; returns the number of messages.

        Args:
            stream: where to.
            origin: name of the broken file.
        """
        writer, unpacker, messages = ChunkWriter(stream), ChunkUnpacker(len(self._data)), 0
        self.metadata[RECOVERY_METADATA] = {"from": origin, "problems": "; ".join(self.problems)}
        writer.add_metadata(RUN_METADATA, self.metadata[RUN_METADATA])
        for attachment in self.attachments.values():
            writer.add_attachment(*attachment)
        # Schemas and channels stand in the first chunk alone, which may be lost; they are the same in every log.
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
        """How long the flight was, s, if the file still tells."""
        with contextlib.suppress(KeyError, ValueError):
            return float(self.metadata[RESULT_METADATA]["flown"])
        with contextlib.suppress(DamageError):
            return read_summary(self._data).last_ns / 1e9
        return None

    def _intact_records(self, position: int) -> Iterator[Record]:
        """Take in every record that is intact, up to the end of the data."""
        patience = _MAX_SEARCHED * len(self._data)
        while not self._ended and position < len(self._data):
            length = 0
            try:
                record = record_at(self._data, position)
                length = len(record.content)
                self._take(record)
            except DamageError as problem:
                self._note(f"byte {position}: {problem}")
                patience -= length
                landmark = _LANDMARK.search(self._data, position + 1)
                if landmark is None or patience < 0:
                    return
                position = landmark.start()
            else:
                position = record.end
                yield record

    def _take(self, record: Record) -> None:
        """Take in a record.

        Raises:
            DamageError: it is not intact.
        """
        match record.opcode:
            case Opcode.METADATA:
                name, entries = read_metadata(record.content)
                self.metadata[name] = entries
            case Opcode.ATTACHMENT:
                attachment = read_attachment(record.content)
                self.attachments[attachment.name] = attachment
            case Opcode.CHUNK:
                list(_messages(self._unpacker.unpack(record.content)))  # all of them can be read
                self._chunks.append(record)
            case Opcode.HEADER | Opcode.MESSAGE_INDEX | Opcode.DATA_END:
                check_bookkeeping(record)
                self._ended = record.opcode == Opcode.DATA_END
            case _:
                raise DamageError("a record that no log has here")

    def _mend_run(self) -> None:
        """Take the record `moflock.run` from its copy, which has a checksum."""
        copied = run_copy({name: attachment.data for name, attachment in self.attachments.items()})
        if copied and copied != self.metadata.get(RUN_METADATA):
            self._note(f"the record {RUN_METADATA} is damaged; its copy is not")
            self.metadata[RUN_METADATA] = copied

    def _note(self, problem: str) -> None:
        if len(self.problems) < _MAX_PROBLEMS:
            self.problems.append(problem)


def _messages(chunk: memoryview) -> Iterator[Message]:
    """The messages of a chunk, of the channels that a log has.

    Raises:
        DamageError: it is not filled by records.
    """
    for record in records_in(chunk):
        if record.opcode == Opcode.MESSAGE:
            message = read_message(record.content)
            if 1 <= message.channel <= len(CHANNELS):
                yield message


def _recovery(
    flight: LoggedFlight, broken: Path, messages: int, known_end: float | None, problems: tuple[str, ...]
) -> Recovery:
    """The figures of a recovered flight."""
    end = float(flight.samples.t[-1])
    # A flight that broke off by itself has never logged its last samples.
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
    """A file to be written, which takes its name when all went well, and else is gone.

    Raises:
        LogError: it cannot be written.
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
        LogError: it is.
    """
    with path.open("rb") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise LogError(f"log: {path}: a flight is writing it") from None
