"""Coverage: how much of the arena a flock has seen."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import entry_kernel

CELL = 10.0
"""Side of a cell, m, for arenas that are a multiple of it."""

SIGHT = 25.0
"""A cell is seen when a drone comes this close to its centre, m, horizontally."""


def coverage(position: NDArray[np.float64], arena_side: float) -> NDArray[np.float64]:
    """Share of the arena's cells that have been seen, over time.

    Args:
        position: (T, N, 3), m, world, as `flight.samples.position`.
        arena_side: m; the arena is a square centred at the origin, cut into equal cells of about CELL.

    Returns:
        (T,), never falling, in [0, 1]; the last value is the flight's coverage.
    """
    cells = max(round(arena_side / CELL), 1)
    seen = np.zeros((cells, cells), np.bool_)
    share = np.empty(len(position))
    _see(np.ascontiguousarray(position, dtype=np.float64), arena_side, SIGHT, seen, share)
    return share


@entry_kernel
def _see(
    position: NDArray[np.float64],
    arena_side: float,
    sight: float,
    seen: NDArray[np.bool_],
    share: NDArray[np.float64],
) -> None:
    """Mark what each sample sees.

    Args:
        position: (T, N, 3), m.
        arena_side: m.
        sight: m.
        seen: (C, C), written.
        share: (T,), written.
    """
    cells = seen.shape[0]
    side = arena_side / cells
    count = 0
    for k in range(position.shape[0]):
        for i in range(position.shape[1]):
            x = position[k, i, 0] + arena_side / 2
            y = position[k, i, 1] + arena_side / 2
            # Cells whose centres, at (c + 1/2) side, lie within a square of half side `sight` around the drone.
            first_row = max(math.ceil((x - sight) / side - 0.5), 0)
            last_row = min(math.floor((x + sight) / side - 0.5), cells - 1)
            first_column = max(math.ceil((y - sight) / side - 0.5), 0)
            last_column = min(math.floor((y + sight) / side - 0.5), cells - 1)
            for row in range(first_row, last_row + 1):
                for column in range(first_column, last_column + 1):
                    if seen[row, column]:
                        continue
                    dx = (row + 0.5) * side - x
                    dy = (column + 0.5) * side - y
                    if dx * dx + dy * dy <= sight * sight:
                        seen[row, column] = True
                        count += 1
        share[k] = count / (cells * cells)
