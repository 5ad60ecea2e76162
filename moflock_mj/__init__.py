"""The testbed: scenarios, sensing, the two dynamics, order parameters, fitness, logs and the command line."""

from controllers.flocking import FlockingParams
from moflock_mj.errors import MoflockError
from moflock_mj.fitness import Fitness
from moflock_mj.flight import fly
from moflock_mj.order_parameters import OrderParameters
from moflock_mj.points import load_point, paper_point
from moflock_mj.scenario import Scenario

__all__ = [
    "Fitness",
    "FlockingParams",
    "MoflockError",
    "OrderParameters",
    "Scenario",
    "fly",
    "load_point",
    "paper_point",
]
