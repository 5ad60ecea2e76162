"""Flocks of quadrotors on MuJoCo physics: scenarios, flights, logs, and their order parameters.

Names are imported at first use, so that `moflock --help` does not load NumPy and Numba.

Example:
    >>> import moflock_mj as mf
    >>> scenario = mf.Scenario(drones=5, duration=20.0, warm_up=5.0)
    >>> flight = mf.fly(mf.load_point("steady"), scenario=scenario, dynamics="point_mass", seed=1)
    >>> flight.complete
    True
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from controllers.policies.registry import POLICIES as POLICIES
    from controllers.policies.vasarhelyi import VasarhelyiParams as VasarhelyiParams
    from moflock_mj.analysis.identification import identify as identify
    from moflock_mj.analysis.step_response import step_response as step_response
    from moflock_mj.analysis.target_tracking import track_target as track_target
    from moflock_mj.analysis.verification import resume as resume
    from moflock_mj.analysis.verification import verify as verify
    from moflock_mj.errors import MoflockError as MoflockError
    from moflock_mj.flight import fly as fly
    from moflock_mj.flight import fly_many as fly_many
    from moflock_mj.log.reader import LoggedFlight as LoggedFlight
    from moflock_mj.log.reader import read_log as read_log
    from moflock_mj.log.recovery import recover as recover
    from moflock_mj.metrics.catalogue import METRICS as METRICS
    from moflock_mj.metrics.fitness import Fitness as Fitness
    from moflock_mj.metrics.order_parameters import OrderParameters as OrderParameters
    from moflock_mj.parameters.bounds import ParameterBounds as ParameterBounds
    from moflock_mj.parameters.points import load_point as load_point
    from moflock_mj.parameters.points import point_names as point_names
    from moflock_mj.scenario.effect_configs import BatteryConfig as BatteryConfig
    from moflock_mj.scenario.effect_configs import DownwashConfig as DownwashConfig
    from moflock_mj.scenario.effect_configs import DragConfig as DragConfig
    from moflock_mj.scenario.effect_configs import GroundEffectConfig as GroundEffectConfig
    from moflock_mj.scenario.effect_configs import ImuConfig as ImuConfig
    from moflock_mj.scenario.effect_configs import PointMassConfig as PointMassConfig
    from moflock_mj.scenario.effect_configs import WindConfig as WindConfig
    from moflock_mj.scenario.faults import FaultConfig as FaultConfig
    from moflock_mj.scenario.scenario import Scenario as Scenario
    from moflock_mj.simulation.results import Flight as Flight
    from moflock_mj.simulation.simulation import Simulation as Simulation
    from moflock_mj.world.circle import Circle as Circle
    from moflock_mj.world.square import Square as Square

_MODULES = {
    "BatteryConfig": "moflock_mj.scenario.effect_configs",
    "Circle": "moflock_mj.world.circle",
    "DownwashConfig": "moflock_mj.scenario.effect_configs",
    "DragConfig": "moflock_mj.scenario.effect_configs",
    "FaultConfig": "moflock_mj.scenario.faults",
    "Fitness": "moflock_mj.metrics.fitness",
    "Flight": "moflock_mj.simulation.results",
    "GroundEffectConfig": "moflock_mj.scenario.effect_configs",
    "ImuConfig": "moflock_mj.scenario.effect_configs",
    "LoggedFlight": "moflock_mj.log.reader",
    "METRICS": "moflock_mj.metrics.catalogue",
    "MoflockError": "moflock_mj.errors",
    "OrderParameters": "moflock_mj.metrics.order_parameters",
    "POLICIES": "controllers.policies.registry",
    "ParameterBounds": "moflock_mj.parameters.bounds",
    "PointMassConfig": "moflock_mj.scenario.effect_configs",
    "Scenario": "moflock_mj.scenario.scenario",
    "Simulation": "moflock_mj.simulation.simulation",
    "Square": "moflock_mj.world.square",
    "VasarhelyiParams": "controllers.policies.vasarhelyi",
    "WindConfig": "moflock_mj.scenario.effect_configs",
    "fly": "moflock_mj.flight",
    "fly_many": "moflock_mj.flight",
    "identify": "moflock_mj.analysis.identification",
    "load_point": "moflock_mj.parameters.points",
    "point_names": "moflock_mj.parameters.points",
    "read_log": "moflock_mj.log.reader",
    "recover": "moflock_mj.log.recovery",
    "resume": "moflock_mj.analysis.verification",
    "step_response": "moflock_mj.analysis.step_response",
    "track_target": "moflock_mj.analysis.target_tracking",
    "verify": "moflock_mj.analysis.verification",
}
"""Module of each public name."""

__all__ = sorted(_MODULES)  # noqa: PLE0605 - type checkers read the imports above


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return __all__
