"""Waiting for a condition, with a deadline."""

from __future__ import annotations

import time


def wait_until(condition, seconds=60.0, pause=0.01):
    """Wait until a condition is true, and return its value; fail where it is not in time."""
    deadline = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < deadline, f"not within {seconds:g} s"
        time.sleep(pause)
    return value
