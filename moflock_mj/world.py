"""The true state of all drones, as the stages of a flight share it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class World(NamedTuple):
    """True positions and velocities of N drones; one contiguous row per axis, so that loops over drones vectorise.

    Attributes:
        position: (3, N), m, world, z up.
        velocity: (3, N), m/s, world.
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
