"""What a velocity policy is given and what it answers: the stage that both flights and a live deployment call."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import stage


class Observation(NamedTuple):
    """What each of N drones knows when it decides; horizontal, world frame.

    Attributes:
        own_position: (2, N), m, with the drone's own GPS error.
        own_velocity: (2, N), m/s, with the drone's own GPS error.
        received_position: (2, M), m, what drone j's packets say of j: late, with the error of j's GPS. M is N, or a
            multiple of it where packets are kept: column j + a N is what the packet a ticks earlier said, carried on.
        received_velocity: (2, M), m/s.
        neighbours: (N, N), row i begins with the columns of the drones that i hears.
        neighbour_count: (N,), how many numbers of each row count.
        wall_distance: (W, N), m, from the own position to each wall, negative beyond it.
        wall_normal: (W, 2, N), unit vectors from each wall into the arena.
    """

    own_position: NDArray[np.float64]
    own_velocity: NDArray[np.float64]
    received_position: NDArray[np.float64]
    received_velocity: NDArray[np.float64]
    neighbours: NDArray[np.int32]
    neighbour_count: NDArray[np.int64]
    wall_distance: NDArray[np.float64]
    wall_normal: NDArray[np.float64]

    @classmethod
    def empty(cls, drones: int, walls: int, kept: int = 0) -> Observation:
        """Arrays of the right shapes, all zero; `kept`: how many earlier packets are kept."""
        return cls(
            own_position=np.zeros((2, drones)),
            own_velocity=np.zeros((2, drones)),
            received_position=np.zeros((2, drones * (1 + kept))),
            received_velocity=np.zeros((2, drones * (1 + kept))),
            neighbours=np.zeros((drones, drones), np.int32),
            neighbour_count=np.zeros(drones, np.int64),
            wall_distance=np.zeros((walls, drones)),
            wall_normal=np.zeros((walls, 2, drones)),
        )


class SpeedLimits(NamedTuple):
    """Speeds of the scenario that a policy keeps, m/s."""

    v_flock: float
    v_max: float
    v_rep_max: float


@stage
def desired_velocity(
    params: NamedTuple, limits: SpeedLimits, observation: Observation, out: NDArray[np.float64]
) -> None:
    """Write each drone's desired velocity to `out`, (2, N), m/s, world."""
    raise NotImplementedError
