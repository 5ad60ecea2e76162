"""The true state of all drones, as the stages of a flight share it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class TrueState(NamedTuple):
    """True positions and velocities of N drones; one contiguous row per axis, so that loops over drones vectorise.

    Attributes:
        position: (3, N), m, world, z up.
        velocity: (3, N), m/s, world.
        touched: (N,), 1 for a drone that has touched another one or the ground; point masses do only when they
            are switched off.
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    touched: NDArray[np.uint8]

    @classmethod
    def at_rest(cls, drones: int) -> TrueState:
        """All drones at the origin."""
        return cls(np.zeros((3, drones)), np.zeros((3, drones)), np.zeros(drones, np.uint8))
