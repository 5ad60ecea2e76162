"""True state of all drones, shared by the stages of a flight."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class TrueState(NamedTuple):
    """True positions and velocities of N drones, with one contiguous row per axis so that loops over drones vectorise.

    Attributes:
        position: (3, N), position, m, world, z up.
        velocity: (3, N), velocity, m/s, world.
        touched: (N,), 1 for a drone that has touched another one or the ground. A point mass touches the ground only
            after power_off, and never another one.
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    touched: NDArray[np.uint8]

    @classmethod
    def at_rest(cls, drones: int) -> TrueState:
        """State with all drones at rest at the origin."""
        return cls(np.zeros((3, drones)), np.zeros((3, drones)), np.zeros(drones, np.uint8))
