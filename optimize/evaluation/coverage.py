"""Coverage: the share of the arena that a flock has seen."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import entry_kernel
from moflock_mj.world.arena import Arena

CELL = 10.0
"""Approximate side of a cell, m; exact for arenas whose sides are a multiple of it."""

SIGHT = 25.0
"""Horizontal distance from a drone to a cell's centre within which the cell counts as seen, m."""


def coverage(position: NDArray[np.float64], arena: Arena) -> NDArray[np.float64]:
    """Share of the arena's cells seen so far, at each sample.

    Args:
        position: (T, N, 3), m, world, as `flight.samples.position`.
        arena: its bounding box is divided into equal cells of about CELL; those with a centre inside the arena count.

    Returns:
        (T,), non-decreasing, in [0, 1]; the last value is the flight's coverage.
    """
    half = np.array(arena.extent())
    cells = np.maximum(np.round(2 * half / CELL).astype(np.int64), 1)
    x, y = ((np.arange(count) + 0.5) * (2 * edge / count) - edge for count, edge in zip(cells, half, strict=True))
    inside = arena.distance_outside(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)) <= 0
    share = np.empty(len(position))
    _see(np.ascontiguousarray(position, dtype=np.float64), half, SIGHT, ~inside, share)
    return share


@entry_kernel
def _see(
    position: NDArray[np.float64],
    half: NDArray[np.float64],
    sight: float,
    seen: NDArray[np.bool_],
    share: NDArray[np.float64],
) -> None:
    """Mark the cells seen in each sample.

    Args:
        position: (T, N, 3), m.
        half: (2,), m, half sides of the box that is divided into cells.
        sight: m, see SIGHT.
        seen: (A, B), true for cells that do not count; updated in place.
        share: (T,), output: share of the cells seen so far.
    """
    rows, columns = seen.shape
    row_side, column_side = 2 * half[0] / rows, 2 * half[1] / columns
    total = seen.size - np.sum(seen)
    count = 0
    for k in range(position.shape[0]):
        for i in range(position.shape[1]):
            x = position[k, i, 0] + half[0]
            y = position[k, i, 1] + half[1]
            # Cells with a centre, at (c + 1/2) side, in a square of half side `sight` around the drone.
            first_row = max(math.ceil((x - sight) / row_side - 0.5), 0)
            last_row = min(math.floor((x + sight) / row_side - 0.5), rows - 1)
            first_column = max(math.ceil((y - sight) / column_side - 0.5), 0)
            last_column = min(math.floor((y + sight) / column_side - 0.5), columns - 1)
            for row in range(first_row, last_row + 1):
                for column in range(first_column, last_column + 1):
                    if seen[row, column]:
                        continue
                    dx = (row + 0.5) * row_side - x
                    dy = (column + 0.5) * column_side - y
                    if dx * dx + dy * dy <= sight * sight:
                        seen[row, column] = True
                        count += 1
        share[k] = count / total
