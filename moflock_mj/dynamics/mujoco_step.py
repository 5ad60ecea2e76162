"""MuJoCo's C `mj_step`, callable from compiled code.

Numba resolves the symbol by name in the library of the mujoco wheel, so that compiled loops can be cached on disk.
Models and data are passed by address.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes.util import find_library
from pathlib import Path
from typing import cast

import llvmlite.binding
import mujoco
from numba.core import types

from moflock_mj.errors import FlightError


def _library() -> str:
    """Path of the shared library that the mujoco package has loaded."""
    folder = Path(mujoco.__file__).parent
    names = ("libmujoco.so*", "libmujoco.*.dylib", "mujoco.dll")
    found = sorted(path for name in names for path in folder.glob(name))
    path = str(found[0]) if found else find_library("mujoco")
    if path is None:
        raise FlightError(f"mujoco: no shared library in {folder}")
    return path


llvmlite.binding.load_library_permanently(_library())

mj_step = cast("Callable[[int, int], None]", types.ExternalFunction("mj_step", types.void(types.intp, types.intp)))
"""`mj_step(model_address, data_address)`, callable in kernels only. The addresses are `MjModel._address` and
`MjData._address`; the caller keeps both objects alive.
"""
