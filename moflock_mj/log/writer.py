"""Writer of a flight's MCAP file, on a separate thread.

The file is named NAME.mcap.part until it is complete. A chunk is closed at least every simulated second, so that a
killed program loses at most the last second. The content does not depend on the wall clock, except for the metadata of
the caller.
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
    """Log of a running flight; a context manager.

    Leaving the context finishes the log, also after Ctrl-C; any other exception aborts it. After a write error, the
    next call removes the unfinished file and raises a LogError.
    """

    def __init__(self, path: str | os.PathLike[str], header: LogHeader) -> None:
        """Open NAME.mcap.part and write the header.

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
        # A daemon thread does not block the exit of a program that has not closed its log.
        self._thread = threading.Thread(target=self._run, name=f"log {self.path.name}", daemon=True)
        self._thread.start()

    def write(self, block: SampleBlock) -> None:
        """Write consecutive samples, which follow those of the previous call.

        The call waits until the previous block is written, which bounds the samples that a killed program loses.

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
        """Wait until all blocks are written."""
        with self._idle:
            self._raise_failure()

    def event(self, event: FlightEvent) -> None:
        """Write an event, in order with the blocks."""
        self._put(event)

    def state(self, time_ns: int, state: bytes) -> None:
        """Write a complete state, from which the flight can be resumed.

        Args:
            time_ns: simulated time, ns.
            state: bytes of the state, see `Simulation.snapshot`.
        """
        self._put(FlightState(time_ns, state))

    def packet(self, packet: LinkPacket) -> None:
        """Write a MAVLink packet."""
        self._put(packet)

    def finish(self, result: Mapping[str, str] | None = None) -> None:
        """Write result and index, and rename the file to its final name; later calls have no effect.

        Args:
            result: final figures, the record `moflock.result`.

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
        """Stop writing and remove the unfinished file; no effect after `finish`."""
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
        # Closing retries a failed write, which fails again on a full disk.
        with contextlib.suppress(OSError):
            self._stream.close()
        with contextlib.suppress(OSError):
            self._part.unlink()

    def _run(self) -> None:
        """Run the writer thread; after a failure it still consumes items, so that the flight does not block."""
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
    """Open the unfinished file with an exclusive lock; overwrite a file left by a dead process."""
    make_folder(path)
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o666)
    try:
        # Truncate only after the lock is held.
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.ftruncate(descriptor, 0)
    except BaseException:
        os.close(descriptor)
        raise
    return os.fdopen(descriptor, "wb")


def _log_error(path: Path, failure: Exception) -> LogError:
    """Convert a failure to a one-line error with the path and the reason."""
    match failure:
        case BlockingIOError():
            reason = "another flight is writing it"
        case OSError(strerror=str(text)):
            reason = text[:1].lower() + text[1:]
        case _:
            reason = f"{type(failure).__name__}: {failure}"
    return LogError(f"log: {path}: {reason}")
