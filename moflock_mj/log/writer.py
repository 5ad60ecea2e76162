"""Writes a flight into one MCAP file, on a thread of its own.

The file is called NAME.mcap.part until it is finished, and its chunk is closed at least every simulated second, so that
whatever kills the program costs at most the last second. Nothing in it depends on the wall clock but what the caller
puts into the metadata.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import queue
import threading
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple, Self

from moflock_mj.errors import LogError
from moflock_mj.files import make_folder
from moflock_mj.log.encoder import Attachment, Encoder, FlightState, LinkPacket, LogHeader, SampleBlock, check_shapes
from moflock_mj.metrics.events import FlightEvent

__all__ = ["Attachment", "FlightEvent", "FlightLog", "LinkPacket", "LogHeader", "SampleBlock"]


class FlightLog:
    """A flight's log while it is written; a context manager.

    Leaving the context finishes the log, also after Ctrl-C; any other exception aborts it. What goes wrong on the disk
    comes up as a LogError at the next call, when the unfinished file is already gone.
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
            self._encoder = Encoder(self._stream, header)
        except BaseException as failure:
            self._remove()
            if isinstance(failure, OSError):
                raise _log_error(self.path, failure) from failure
            raise
        self._queue: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._idle = threading.Semaphore()
        # A daemon, so that a program that dies without closing its log does not wait for it for ever.
        self._thread = threading.Thread(target=self._run, name=f"log {self.path.name}", daemon=True)
        self._thread.start()

    def write(self, block: SampleBlock) -> None:
        """Hand over sample ticks, which follow those handed over before.

        Waits until the block before is on the disk, so that a flight never gets far ahead of what survives it.

        Raises:
            ValueError: an array has the wrong shape.
            LogError: the log could not be written.
        """
        check_shapes(block, self._drones)
        self._idle.acquire()
        try:
            self._put(block)
        except BaseException:
            self._idle.release()
            raise

    def settle(self) -> None:
        """Wait until all blocks are on the disk."""
        with self._idle:
            self._raise_failure()

    def event(self, event: FlightEvent) -> None:
        """Record an event, in the place where it comes between the blocks."""
        self._put(event)

    def state(self, time_ns: int, state: bytes) -> None:
        """Record the complete state from which the flight can be resumed.

        Args:
            time_ns: simulated time in ns.
            state: MuJoCo's integration state and all else that the flight carries from step to step.
        """
        self._put(FlightState(time_ns, state))

    def packet(self, packet: LinkPacket) -> None:
        """Record a packet of MAVLink."""
        self._put(packet)

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
        """The writer thread; after a failure it goes on taking items, so that the flight never waits in vain."""
        while True:
            item = self._queue.get()
            if self._failure is None:
                try:
                    self._handle(item)
                except Exception as failure:
                    self._failure = failure
            if isinstance(item, SampleBlock):
                self._idle.release()
            if item is None or isinstance(item, _Finish):
                return

    def _handle(self, item: Any) -> None:
        match item:
            case SampleBlock():
                self._encoder.block(item)
            case FlightEvent():
                self._encoder.event(item)
            case FlightState():
                self._encoder.state(item)
            case LinkPacket():
                self._encoder.packet(item)
            case _Finish():
                self._encoder.finish(item.result)
                self._part.replace(self.path)
                self._stream.close()


class _Finish(NamedTuple):
    result: Mapping[str, str] | None


def _open(path: Path, part: Path) -> IO[bytes]:
    """Open the unfinished file for this process alone; one that a dead process left is overwritten."""
    make_folder(path)
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
        case OSError(strerror=str(text)):
            reason = text[:1].lower() + text[1:]
        case _:
            reason = f"{type(failure).__name__}: {failure}"
    return LogError(f"log: {path}: {reason}")
