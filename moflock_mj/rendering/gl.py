"""Which GL renders videos. Only the processes that render load one; the command itself imports MuJoCo without."""

from __future__ import annotations

import os
import subprocess
import sys

from moflock_mj.errors import RenderError

_MUJOCO_READS = "MUJOCO_GL"
_ASKED = "MOFLOCK_GL"
"""Where a command that does without GL keeps what MUJOCO_GL said."""

_PROBE = "import mujoco; mujoco.GLContext(16, 16).make_current()"


def do_without_gl() -> None:
    """Let MuJoCo, which reads MUJOCO_GL when it is first imported, load no GL into this process, nor fail at one."""
    os.environ.setdefault(_ASKED, os.environ.get(_MUJOCO_READS, ""))
    os.environ[_MUJOCO_READS] = "disable"


def environment_with(way: str) -> dict[str, str]:
    """The environment of a process that renders in a way that `find_gl` found."""
    return {**os.environ, _MUJOCO_READS: way}


def find_gl() -> str:
    """The way to render without a screen that works here: what MUJOCO_GL says, else egl, else osmesa.

    Raises:
        RenderError: none does.
    """
    asked = os.environ.get(_ASKED, os.environ.get(_MUJOCO_READS))
    ways = (asked,) if asked else ("egl", "osmesa")
    for way in ways:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE], env=environment_with(way), capture_output=True, check=False
        )
        if probe.returncode == 0:
            return way
    raise RenderError(f"video: no GL: {' and '.join(ways)} failed; on Debian: apt-get install libegl1 libosmesa6")
