"""The search's commands in a real terminal: progress bars exist there alone, so that a pipe would hide their faults."""

from __future__ import annotations

import errno
import os
import pty
import struct
import subprocess
import termios
from fcntl import ioctl

import pytest

from tests.support.cli import MOFLOCK

pytestmark = pytest.mark.slow
TINY = ("--drones", 4, "--duration", 2, "--workers", 1)
SEARCH = ("--drones", 4, "--duration", 4, "--budget", 24, "--population", 8, "--workers", 1)


def run_in_terminal(*arguments, columns=100):
    """Exit status of a command under a pseudo-terminal of this width, and all that it wrote to it."""
    ours, theirs = pty.openpty()
    ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES", "NO_COLOR")}
    process = subprocess.Popen(
        [MOFLOCK, *map(str, arguments)],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env=environment | {"TERM": "xterm-256color"},
        start_new_session=True,
    )
    os.close(theirs)
    written = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError as problem:
            if problem.errno != errno.EIO:  # EIO: the other end is closed
                raise
            break
        if not part:
            break
        written += part
    os.close(ours)
    return process.wait(60), written.decode(errors="replace")


def succeed(*arguments):
    status, written = run_in_terminal(*arguments)
    assert (status, "Traceback" in written) == (0, False), written[-3000:]
    return written


@pytest.fixture(scope="module")
def finished_search(tmp_path_factory):
    """The run directory of a search that ended in a terminal, and what it showed."""
    path = tmp_path_factory.mktemp("terminal") / "run"
    return path, succeed("optimize", *SEARCH, "--front-seeds", 3, "--out", path)


def test_a_search_and_its_front_show_their_progress(finished_search):
    path, written = finished_search
    assert "front on fresh seeds" in written
    assert "of 24" in written
    assert (path / "front.json").is_file()


@pytest.mark.parametrize("command", ["resume", "report", "pick"])
def test_what_reads_a_search_runs_in_a_terminal(command, finished_search, tmp_path):
    path, _ = finished_search
    arguments = {
        "resume": ("optimize", "--resume", path),
        "report": ("report", path, "--seeds", 3),
        "pick": ("pick", path, "--seeds", 3, "--out", tmp_path / "point.json"),
    }[command]
    succeed(*arguments)


@pytest.mark.parametrize(
    "arguments",
    [
        ("pca", "--points", 20, *TINY),
        ("sensitivity", "A", "--samples", 2, "--levels", 2, "--seeds", 2, *TINY),
        ("sweep", "A", "--drones", "2,3", "--seeds", 2, "--duration", 2, "--workers", 1),
        ("validate", "A", "--seeds", 2, *TINY),
    ],
    ids=lambda arguments: arguments[0],
)
def test_what_flies_many_flights_runs_in_a_terminal(arguments, tmp_path):
    assert "flights" in succeed(*arguments, "--out", tmp_path / arguments[0])
