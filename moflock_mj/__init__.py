"""The testbed: scenarios, sensing, the two dynamics, order parameters, fitness, logs and the command line.

Names are imported when they are first used, so that `moflock --help` need not wait for NumPy and Numba.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from controllers.policies.vasarhelyi import VasarhelyiParams
    from moflock_mj.errors import MoflockError
    from moflock_mj.flight import fly
    from moflock_mj.log.reader import LoggedFlight, read_log
    from moflock_mj.metrics.fitness import Fitness
    from moflock_mj.metrics.order_parameters import OrderParameters
    from moflock_mj.parameters.points import load_point, paper_point
    from moflock_mj.scenario.scenario import Scenario
    from moflock_mj.simulation.results import Flight

__all__ = [
    "Fitness",
    "Flight",
    "LoggedFlight",
    "MoflockError",
    "OrderParameters",
    "Scenario",
    "VasarhelyiParams",
    "fly",
    "load_point",
    "paper_point",
    "read_log",
]

_HOMES = {
    "Fitness": "moflock_mj.metrics.fitness",
    "Flight": "moflock_mj.flight",
    "VasarhelyiParams": "controllers.policies.vasarhelyi",
    "LoggedFlight": "moflock_mj.log.reader",
    "MoflockError": "moflock_mj.errors",
    "OrderParameters": "moflock_mj.metrics.order_parameters",
    "Scenario": "moflock_mj.scenario.scenario",
    "fly": "moflock_mj.flight",
    "load_point": "moflock_mj.parameters.points",
    "paper_point": "moflock_mj.parameters.points",
    "read_log": "moflock_mj.log.reader",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)
