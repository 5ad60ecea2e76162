"""`fly`: one flight from its parameters to its fitness."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.flocking import FlockingParams
from moflock_mj.fitness import Fitness, fitness_of
from moflock_mj.flock import Flock
from moflock_mj.loop import Record
from moflock_mj.order_parameters import OrderParameters
from moflock_mj.points import check_point
from moflock_mj.scenario import Scenario

_CHUNK = 10.0
"""Simulated seconds between two looks at the clock, without a log."""


def fly(
    params: FlockingParams,
    *,
    scenario: Scenario | None = None,
    dynamics: str = "rigid_body",
    seed: int = 1,
    log: str | Path | None = None,
    keep_samples: bool = True,
):
    flock = Flock(check_point(params), scenario or Scenario(), dynamics, seed)
    while not flock.finished:
        record = flock.fly(_CHUNK)
    op = OrderParameters(*record.order_parameters[-1].tolist())
    class R: pass
    r=R(); r.order_parameters=op; r.fitness=fitness_of(op, flock.scenario)
    return r
