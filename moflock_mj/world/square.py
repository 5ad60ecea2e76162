"""Arenas: named tuples that tell how far each wall is and which way leads inside."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import implements
from moflock_mj.world.walls import locate_walls


class SquareArena(NamedTuple):
    """A square centred at the origin, its sides along x and y.

    Attributes:
        side: m.
    """

    side: float

    @property
    def walls(self) -> int:
        """Walls that a drone is told of: the nearer one of each axis."""
        return 2

    def outline(self) -> NDArray[np.float64]:
        """Corners, anticlockwise: (4, 2), m."""
        return self.side / 2 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@implements(locate_walls, SquareArena)
def locate_square_walls(
    arena: SquareArena, position: NDArray[np.float64], distance: NDArray[np.float64], normal: NDArray[np.float64]
) -> None:
    for axis in range(2):
        for i in range(position.shape[1]):
            distance[axis, i] = arena.side / 2 - abs(position[axis, i])
            normal[axis, axis, i] = -np.sign(position[axis, i])
            normal[axis, 1 - axis, i] = 0.0
