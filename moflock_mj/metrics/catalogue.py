"""Catalogue of metrics: names, units and plot styles of the order parameters, and their fitnesses."""

from __future__ import annotations

from typing import Any, NamedTuple


class Metric(NamedTuple):
    """Order parameter and its fitness.

    Attributes:
        key: name of the field in `OrderParameters`.
        unit: unit for display; empty for a plain number.
        label: short description for legends.
        colour: colour of the curve (Okabe and Ito 2008).
        dashes: matplotlib line style of the curve: solid if large values are better, broken if small ones are.
        fitness: name of the field in `Fitness`.
        group: number of the paper's objective with the fitness as a factor, 1 or 2.
        number: field number of the order parameter in the log's `/metrics`; a new metric takes the next free number.
        fitness_number: field number of the fitness in the log's `/metrics`.
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
"""Metrics in the order of `OrderParameters`."""

OBJECTIVES = {"F_1": 13, "F_2": 14, "F_product": 15}
"""Field numbers in `/metrics` of the objectives, which are products of fitnesses."""
