"""Round arena."""

from __future__ import annotations

from math import pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.compiling import implements
from moflock_mj.world.walls import locate_walls

_CORNERS = 64
"""Number of corners of the polygon that approximates the circle in figures."""


class Circle(NamedTuple):
    """Circle centred at the origin; see `Arena`.

    Attributes:
        radius: radius, m.
    """

    radius: float

    @property
    def walls(self) -> int:
        """One wall: the tangent at the nearest point of the circle."""
        return 1

    @property
    def title(self) -> str:
        return f"round arena of {2 * self.radius:g} m"

    def outline(self) -> NDArray[np.float64]:
        angles = 2 * pi * np.arange(_CORNERS) / _CORNERS
        return self.radius * np.stack((np.cos(angles), np.sin(angles)), axis=1)

    def extent(self) -> tuple[float, float]:
        return self.radius, self.radius

    def area(self) -> float:
        return pi * self.radius**2

    def sample(self, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
        distance, angle = self.radius * np.sqrt(rng.random(count)), 2 * pi * rng.random(count)
        return np.stack((distance * np.cos(angle), distance * np.sin(angle)), axis=1)

    def inset(self, margin: float) -> Circle:
        return Circle(self.radius - margin)

    def distance_outside(self, position: ArrayLike) -> NDArray[np.float64]:
        return np.asarray(np.linalg.norm(np.asarray(position, np.float64)[..., :2], axis=-1) - self.radius)

    def circle(self) -> tuple[float, float, float]:
        return 0.0, 0.0, self.radius


@implements(locate_walls, Circle)
def locate_round_wall(
    arena: Circle, position: NDArray[np.float64], distance: NDArray[np.float64], normal: NDArray[np.float64]
) -> None:
    for i in range(position.shape[1]):
        x, y = position[0, i], position[1, i]
        distance_to_centre = sqrt(x * x + y * y)
        distance[0, i] = arena.radius - distance_to_centre
        normal[0, 0, i] = -x / distance_to_centre if distance_to_centre > 0 else 1.0
        normal[0, 1, i] = -y / distance_to_centre if distance_to_centre > 0 else 0.0


SHAPE = "circle"

ARENA = Circle

FIELDS = (("radius", "m", "radius; the centre is the origin", 1.0, 1e5),)
