"""Compiled stages of a flight that tests can call."""

from __future__ import annotations

import functools

import numba


@functools.cache
def compiled(stage, arguments):
    """Compile a stage with a number of arguments; numba selects the implementation by the type of the first."""
    names = ", ".join(f"a{k}" for k in range(arguments))
    scope = {"stage": stage}
    exec(f"def call({names}):\n    return stage({names})", scope)
    return numba.njit(scope["call"])
