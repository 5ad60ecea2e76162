"""The command `moflock`, called in this process and run as a program of its own."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import pytest

from moflock_mj.cli.app import main
from moflock_mj.mavlink.signing import KEY_VARIABLE

BIN = Path(sys.executable).parent
"""Folder of the installed programs."""
MOFLOCK = BIN / "moflock"

COLUMNS = "200"
"""Width of the terminal that the command believes in."""


class Done(NamedTuple):
    """How a command ended and what it wrote."""

    returncode: int
    stdout: str
    stderr: str


def environment_of(changes):
    """The environment of a command: this one without a key for MAVLink, with a known width, and with the changes."""
    clean = {name: value for name, value in os.environ.items() if name != KEY_VARIABLE}
    return clean | {"COLUMNS": COLUMNS} | {name: str(value) for name, value in changes.items()}


def run(*arguments, cwd=None, **environment):
    """The command in this process, as its program calls it; no interpreter starts and no kernel is loaded again.

    Arguments, environment, working directory and the handler of SIGTERM are as before when it has ended.
    """
    out, err = io.StringIO(), io.StringIO()
    handler = signal.getsignal(signal.SIGTERM)
    try:
        with (
            mock.patch.object(sys, "argv", ["moflock", *map(str, arguments)]),
            mock.patch.dict(os.environ, environment_of(environment), clear=True),
            contextlib.chdir(cwd or Path.cwd()),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            pytest.raises(SystemExit) as end,
        ):
            main()
    finally:
        signal.signal(signal.SIGTERM, handler)
    return Done(end.value.code, out.getvalue(), err.getvalue())


def run_program(*arguments, cwd=None, **environment):
    """The command as a program of its own."""
    done = subprocess.run(
        [MOFLOCK, *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        timeout=300,
        check=False,
        env=environment_of(environment),
    )
    return Done(done.returncode, done.stdout, done.stderr)


def start_program(*arguments, cwd=None, **options):
    """The command as a program that goes on; its outputs are pipes of text unless the options differ."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([MOFLOCK, *map(str, arguments)], cwd=cwd, **{"env": environment_of({})} | pipes | options)


def refused(*arguments, cwd=None, **environment):
    """The one line by which the command, called in this process, refuses its arguments."""
    return line_of_refusal(run(*arguments, cwd=cwd, **environment))


def line_of_refusal(done):
    """The line on stderr of a command that has refused its arguments and written nothing else."""
    assert (done.returncode, done.stdout) == (2, ""), done
    assert done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith("moflock: ")
    return done.stderr.rstrip("\n")


def json_of(*arguments, cwd=None):
    """What the command prints with --json."""
    done = run(*arguments, "--json", cwd=cwd)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
