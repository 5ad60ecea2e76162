"""The stage that finds the walls of an arena as each drone sees them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import stage


@stage
def locate_walls(
    arena: NamedTuple, position: NDArray[np.float64], distance: NDArray[np.float64], normal: NDArray[np.float64]
) -> None:
    """Write the walls as seen from `position`.

    Args:
        arena: the arena.
        position: (2 or more, N), m, world; x and y are used.
        distance: (W, N), m, to each wall, negative beyond it; written.
        normal: (W, 2, N), unit vectors from each wall inwards; written.
    """
    raise NotImplementedError
