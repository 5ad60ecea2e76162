"""The autopilots' own programs: started each in a folder of its own, ended with all their children."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from moflock_mj.errors import FleetError

OUTPUT = "output.txt"
"""What a program has printed, in its folder."""

_GRACE = 1.0
"""s between asking a program to end and ending it."""

PLACEHOLDERS = {
    "instance": "number of the vehicle, from 0",
    "sysid": "its MAVLink system id, from 1",
    "port": "where the physics of this vehicle listens",
    "home": "latitude,longitude,altitude,heading of the world's origin",
    "speed": "simulated over real time",
    "here": "the folder in which moflock was started",
}
"""What a command may contain in braces."""


def fill_command(template: str, values: dict[str, Any]) -> list[str]:
    """The words of a command, as a shell would split them, with placeholders filled.

    A program given by a relative path is looked for where moflock was started.

    Args:
        template: such as "arducopter -I{instance}".
        values: by placeholder.

    Raises:
        FleetError: quotes are not closed, there is no word, or a placeholder is unknown.
    """
    try:
        words = [word.format_map(values) for word in shlex.split(template)]
    except (KeyError, IndexError, AttributeError) as problem:
        raise FleetError(
            f"autopilot-command: placeholder {problem} is unknown: there are {', '.join(PLACEHOLDERS)}"
        ) from None
    except ValueError as problem:
        raise FleetError(f"autopilot-command: {problem}") from None
    if not words:
        raise FleetError("autopilot-command: it is empty: it must name a program")
    if "/" in words[0]:
        # Not resolved: a program may go by the name of the link to it, as a virtual environment's Python does.
        words[0] = str(Path(words[0]).expanduser().absolute())
    return words


class Processes:
    """Running programs; a context manager that ends them.

    Args:
        commands: words of each.
        folder: where each gets a folder of its own, `0`, `1`, ...

    Raises:
        FleetError: one cannot be started; none is left running then.
    """

    def __init__(self, commands: Sequence[Sequence[str]], folder: Path) -> None:
        self.folder = folder
        self._running: list[subprocess.Popen[bytes]] = []
        try:
            for number, words in enumerate(commands):
                self._running.append(_start(words, folder / str(number)))
        except BaseException:
            self.end()
            raise

    def ended(self, number: int) -> str | None:
        """How a program has ended, in words; None while it runs."""
        status = self._running[number].poll()
        if status is None:
            return None
        how = f"signal {-status}" if status < 0 else f"status {status}"
        return f"it has ended with {how}: see {self.folder / str(number) / OUTPUT}"

    def end(self) -> None:
        """End all programs and what they have started, even if a second Ctrl-C breaks off the waiting for them."""
        try:
            self._tell_all(signal.SIGTERM)
        finally:
            # ArduPilot does not end while it waits for its physics, and a child may have outlived its parent.
            self._tell_all(signal.SIGKILL)

    def _tell_all(self, signal_number: int) -> None:
        """Send a signal to all groups, and wait a little for the programs to end."""
        for program in self._running:
            _tell_group(program, signal_number)
        deadline = time.monotonic() + _GRACE
        while any(program.poll() is None for program in self._running) and time.monotonic() < deadline:
            time.sleep(0.02)

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *error: object) -> None:
        self.end()


def _start(words: Sequence[str], folder: Path) -> subprocess.Popen[bytes]:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / OUTPUT).open("wb") as output:
            return subprocess.Popen(
                words,
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
    except OSError as problem:
        raise FleetError(f"autopilot-command: {words[0]}: {problem.strerror}") from None


def _tell_group(program: subprocess.Popen[bytes], signal_number: int) -> None:
    """Send a signal to a program and all that it has started, as far as they have not left its group."""
    try:
        os.killpg(program.pid, signal_number)
    except (ProcessLookupError, PermissionError):
        return  # nobody is left
