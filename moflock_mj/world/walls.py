"""Stage that locates the walls of an arena relative to each drone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import stage


@stage
def locate_walls(
    arena: NamedTuple, position: NDArray[np.float64], distance: NDArray[np.float64], normal: NDArray[np.float64]
) -> None:
    """Write distance and normal of each wall for each drone.

    Args:
        arena: the arena.
        position: (2 or more, N), positions, m, world; x and y are used.
        distance: (W, N), distance to each wall, m, negative beyond it; written.
        normal: (W, 2, N), unit normal of each wall, inwards; written.
    """
    raise NotImplementedError
