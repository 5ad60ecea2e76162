"""The catalogue of metrics: what each order parameter is called, measured in and drawn like, and its fitness."""

from __future__ import annotations

from typing import Any, NamedTuple


class Metric(NamedTuple):
    """One order parameter and the fitness that it gives.

    Attributes:
        key: its field in `OrderParameters`.
        unit: as people read it; empty for a plain number.
        label: a few words for legends.
        colour: of its curve (Okabe and Ito 2008).
        dashes: line style of its curve, as matplotlib takes it: solid for what should be large, broken for what should
            be small.
        fitness: its field in `Fitness`.
        group: the paper's objective that the fitness is a factor of, 1 or 2.
        number: field number of the order parameter in the log's `/metrics`; a new metric takes the next free number.
        fitness_number: the same of the fitness.
    """

    key: str
    unit: str
    label: str
    colour: str
    dashes: Any
    fitness: str
    group: int
    number: int
    fitness_number: int

    @property
    def symbol(self) -> str:
        """Name of the order parameter in logs and tables, such as `phi_wall`."""
        return f"phi_{self.key}"

    @property
    def fitness_symbol(self) -> str:
        """Name of the fitness in logs and tables, such as `F_speed`."""
        return f"F_{self.fitness}"


METRICS = (
    Metric("wall", "m", "beyond the wall", "#d55e00", (0, (5, 2)), "wall", 1, 1, 7),
    Metric("vel", "m/s", "speed", "#0072b2", "solid", "speed", 1, 2, 8),
    Metric("corr", "", "correlation", "#009e73", "solid", "corr", 2, 3, 9),
    Metric("coll", "of all pairs", "colliding pairs", "#222222", (0, (1, 1.2)), "coll", 2, 4, 10),
    Metric("disc", "drones", "disconnected", "#cc79a7", (0, (5, 2)), "disc", 2, 5, 11),
    Metric("cluster", "neighbours", "fewest neighbours", "#e69f00", "solid", "cluster", 2, 6, 12),
)
"""In the order of `OrderParameters`."""

OBJECTIVES = {"F_1": 13, "F_2": 14, "F_product": 15}
"""Field numbers of the objectives, which are products of fitnesses, in `/metrics`."""
