"""Processes of real autopilots: each one starts in its own folder, and ends with all its children."""

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
"""File with the output of a program, in its folder."""

_GRACE = 1.0
"""Time between SIGTERM and SIGKILL, s."""

PLACEHOLDERS = {
    "instance": "number of the vehicle, from 0",
    "sysid": "MAVLink system id of the vehicle, from 1",
    "port": "port on which the physics of the vehicle listens",
    "home": "latitude,longitude,altitude,heading of the world's origin",
    "speed": "simulated seconds per real second",
    "here": "folder in which moflock was started",
}
"""Placeholders that a command may contain in braces, and their meaning."""


def fill_command(template: str, values: dict[str, Any]) -> list[str]:
    """Split a command into words like a shell, and fill in its placeholders.

    The relative path of a program starts at the folder in which moflock was started.

    Args:
        template: command such as "arducopter -I{instance}".
        values: values by placeholder.

    Raises:
        FleetError: quotes are not closed, the command is empty, or a placeholder is unknown.
    """
    try:
        words = [word.format_map(values) for word in shlex.split(template)]
    except (KeyError, IndexError, AttributeError) as problem:
        raise FleetError(
            f"autopilot-command: placeholder {problem} is unknown: it must be one of {', '.join(PLACEHOLDERS)}"
        ) from None
    except ValueError as problem:
        raise FleetError(f"autopilot-command: {problem}") from None
    if not words:
        raise FleetError("autopilot-command: it is empty: it must name a program")
    if "/" in words[0]:
        # Links are not resolved, since a program can depend on the name of its link, like Python in a virtual env.
        words[0] = str(Path(words[0]).expanduser().absolute())
    return words


class Processes:
    """Running programs; a context manager that ends them.

    Args:
        commands: words of each command.
        folder: folder in which each program gets its own folder, `0`, `1`, ...

    Raises:
        FleetError: a program cannot be started; all others are ended.
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
        """End of a program, in words; None while it runs."""
        status = self._running[number].poll()
        if status is None:
            return None
        how = f"signal {-status}" if status < 0 else f"status {status}"
        return f"its program ended with {how}: see {self.folder / str(number) / OUTPUT}"

    def end(self) -> None:
        """End all programs and their children, even if a second Ctrl-C interrupts the wait for them."""
        try:
            self._signal_all(signal.SIGTERM)
        finally:
            # ArduPilot does not end while it waits for its physics, and a child can outlive its parent.
            self._signal_all(signal.SIGKILL)

    def _signal_all(self, signal_number: int) -> None:
        """Send a signal to all process groups, and wait up to `_GRACE` for the programs to end."""
        for program in self._running:
            _signal_group(program, signal_number)
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


def _signal_group(program: subprocess.Popen[bytes], signal_number: int) -> None:
    """Send a signal to the process group of a program."""
    try:
        os.killpg(program.pid, signal_number)
    except (ProcessLookupError, PermissionError):
        return  # the group is empty
