"""Square arena, as in the paper."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.compiling import implements
from moflock_mj.world.walls import locate_walls


class Square(NamedTuple):
    """Square centred at the origin, with sides along x and y; see `Arena`.

    Attributes:
        side: length of a side, m.
    """

    side: float

    @property
    def walls(self) -> int:
        """Two walls: the nearer one of each axis."""
        return 2

    @property
    def title(self) -> str:
        return f"{self.side:g} m arena"

    def outline(self) -> NDArray[np.float64]:
        return self.side / 2 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])

    def extent(self) -> tuple[float, float]:
        return self.side / 2, self.side / 2

    def area(self) -> float:
        return self.side**2

    def sample(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        return rng.uniform(-self.side / 2, self.side / 2, (count, 2))

    def inset(self, margin: float) -> Square:
        return Square(self.side - 2 * margin)

    def distance_outside(self, position: ArrayLike) -> NDArray[np.float64]:
        places = np.abs(np.asarray(position))
        # Faster than a maximum over the last axis, which has two places only.
        return np.asarray(np.maximum(places[..., 0], places[..., 1]) - self.side / 2)

    def circle(self) -> None:
        return None


@implements(locate_walls, Square)
def locate_square_walls(
    arena: Square, position: NDArray[np.float64], distance: NDArray[np.float64], normal: NDArray[np.float64]
) -> None:
    for axis in range(2):
        for i in range(position.shape[1]):
            distance[axis, i] = arena.side / 2 - abs(position[axis, i])
            normal[axis, axis, i] = -np.sign(position[axis, i])
            normal[axis, 1 - axis, i] = 0.0


SHAPE = "square"

ARENA = Square

FIELDS = (("side", "m", "length of a side; the centre is the origin", 1.0, 1e5),)
