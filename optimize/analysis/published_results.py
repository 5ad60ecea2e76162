"""Published results of the paper and its simulator, for comparison.

Sources: Bansal, Sethi, Anicho and Nagar, Drone Flocking Optimization using NSGA-II and Principal Component Analysis:
its figure of the PCA matrices and its table of results. The parameters of its points are in
`moflock_mj.parameters.points`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

FIRST_COMPONENT = np.array([0.191, 0.329, -0.495, -0.285, -0.509, -0.518])
"""(6,), first component of the standardised fitnesses of 500 random points, in the order of FITNESS_NAMES."""

COVARIANCE = np.array(
    [
        [1.002, 0.282, -0.172, -0.115, -0.094, -0.131],
        [0.282, 1.002, -0.285, -0.283, -0.301, -0.259],
        [-0.172, -0.285, 1.002, 0.253, 0.581, 0.682],
        [-0.115, -0.283, 0.253, 1.002, 0.278, 0.204],
        [-0.094, -0.301, 0.581, 0.278, 1.002, 0.748],
        [-0.131, -0.259, 0.682, 0.204, 0.748, 1.002],
    ]
)
"""(6, 6), covariance of the same fitnesses."""


class Reached(NamedTuple):
    """Mean and standard deviation of the two objectives over flights.

    Attributes:
        F_1: (mean, standard deviation).
        F_2: (mean, standard deviation).
        source: source of the values.
    """

    F_1: tuple[float, float]
    F_2: tuple[float, float]
    source: str


PAPER_RESULTS = {
    "A": Reached((0.890, 0.039), (0.112, 0.090), "the paper's table of results, 100 flights on MOflock"),
    "B": Reached((0.065, 0.039), (0.896, 0.179), "the paper's table of results, 100 flights on MOflock"),
}
"""Results that the paper prints for its two points."""

MOFLOCK_RESULTS = {
    "model_optimum": Reached((0.815, 0.008), (0.881, 0.018), "MOflock, run headless on 4 seeds at a step of 0.1 s"),
    "A": Reached((0.889, 0.039), (0.095, 0.067), "MOflock, run headless on 4 seeds at a step of 0.1 s"),
    "B": Reached((0.063, 0.029), (0.936, 0.025), "MOflock, run headless on 4 seeds at a step of 0.1 s"),
}
"""Results of the paper's simulator, run for this project."""
