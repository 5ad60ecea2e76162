"""Selection of the OpenGL backend for videos; only rendering processes load one."""

from __future__ import annotations

import os
import subprocess
import sys

from moflock_mj.errors import RenderError

_MUJOCO_VARIABLE = "MUJOCO_GL"
_SAVED_VARIABLE = "MOFLOCK_GL"
"""Environment variable that keeps the user's MUJOCO_GL while the command itself runs without OpenGL."""

_PROBE = "import mujoco; mujoco.GLContext(16, 16).make_current()"


def do_without_gl() -> None:
    """Disable OpenGL for this process; MuJoCo reads MUJOCO_GL when it is first imported."""
    os.environ.setdefault(_SAVED_VARIABLE, os.environ.get(_MUJOCO_VARIABLE, ""))
    os.environ[_MUJOCO_VARIABLE] = "disable"


def environment_with(backend: str) -> dict[str, str]:
    """Environment of a process that renders with a backend from `find_gl`."""
    return {**os.environ, _MUJOCO_VARIABLE: backend}


def find_gl() -> str:
    """Find a backend that renders without a screen: the one in MUJOCO_GL, else egl, else osmesa.

    Raises:
        RenderError: no backend works.
    """
    requested = os.environ.get(_SAVED_VARIABLE, os.environ.get(_MUJOCO_VARIABLE))
    backends = (requested,) if requested else ("egl", "osmesa")
    for backend in backends:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE], env=environment_with(backend), capture_output=True, check=False
        )
        if probe.returncode == 0:
            return backend
    raise RenderError(f"video: no GL: {' and '.join(backends)} failed; on Debian: apt-get install libegl1 libosmesa6")
