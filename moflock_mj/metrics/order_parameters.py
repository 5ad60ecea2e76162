"""The six order parameters that score a flight, computed from the true state at each sample."""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import kernel
from moflock_mj.metrics.catalogue import METRICS
from moflock_mj.world.state import TrueState
from moflock_mj.world.walls import locate_walls

OUTSIDE, CLOSE, TOUCHED = 1, 2, 4
"""Flags of a drone's status: beyond a wall; closer than r_coll to another; touched another drone or the ground."""


class OrderParameters(NamedTuple):
    """Order parameters over a flight, or arrays of them over time.

    Attributes:
        wall: mean distance beyond the wall of the drones that are beyond it, m; 0 if none is.
        vel: mean speed, m/s.
        corr: mean correlation of a drone's velocity with its neighbours', 1.
        coll: fraction of the pairs that are closer than r_coll, 1.
        disc: mean number of drones without a neighbour, 1.
        cluster: mean of the smallest number of neighbours, 1.
    """

    wall: float
    vel: float
    corr: float
    coll: float
    disc: float
    cluster: float


class MetricRanges(NamedTuple):
    """Distances of the order parameters, m.

    Attributes:
        r_cluster: distance within which two drones are neighbours.
        r_coll: distance within which two drones collide.
    """

    r_cluster: float
    r_coll: float


class MetricAccumulator(NamedTuple):
    """Sums over the samples so far, and buffers for the latest sample.

    Attributes:
        sums: (8,), number of samples, number of drone-samples outside, and the sums of `OrderParameters` in its order.
        neighbours: (N,), number of neighbours.
        correlation: (N,), sum of the velocity correlations with the neighbours.
        heading: (3, N), unit vectors along the velocities.
        status: (N,), status flags.
        wall_distance: (W, N), distance to each wall, m.
        wall_normal: (W, 2, N), unit normal of each wall, inwards.
    """

    sums: NDArray[np.float64]
    neighbours: NDArray[np.int64]
    correlation: NDArray[np.float64]
    heading: NDArray[np.float64]
    status: NDArray[np.uint8]
    wall_distance: NDArray[np.float64]
    wall_normal: NDArray[np.float64]

    @classmethod
    def empty(cls, drones: int, walls: int) -> MetricAccumulator:
        """Accumulator without samples."""
        return cls(
            sums=np.zeros(2 + len(METRICS)),
            neighbours=np.zeros(drones, np.int64),
            correlation=np.zeros(drones),
            heading=np.zeros((3, drones)),
            status=np.zeros(drones, np.uint8),
            wall_distance=np.zeros((walls, drones)),
            wall_normal=np.zeros((walls, 2, drones)),
        )


@kernel
def _count_walls(world: TrueState, arena: NamedTuple, accumulator: MetricAccumulator) -> tuple[float, float]:
    """Number of drones beyond a wall, and the sum of their distances beyond it, m."""
    locate_walls(arena, world.position, accumulator.wall_distance, accumulator.wall_normal)
    outside, distance = 0.0, 0.0
    for i in range(accumulator.status.size):
        depth = -inf
        for wall in range(accumulator.wall_distance.shape[0]):
            depth = max(depth, -accumulator.wall_distance[wall, i])
        accumulator.status[i] = TOUCHED if world.touched[i] else 0
        if depth > 0:
            outside += 1
            distance += depth
            accumulator.status[i] |= OUTSIDE
    return outside, distance


@kernel
def _count_speeds(world: TrueState, accumulator: MetricAccumulator) -> float:
    """Sum of the speeds, m/s; also writes the headings (zero for a drone at rest)."""
    vx, vy, vz = world.velocity
    total = 0.0
    for i in range(vx.size):
        speed = sqrt(vx[i] * vx[i] + vy[i] * vy[i] + vz[i] * vz[i])
        scale = 1 / speed if speed > 0 else 0.0
        accumulator.heading[0, i], accumulator.heading[1, i], accumulator.heading[2, i] = (
            scale * vx[i],
            scale * vy[i],
            scale * vz[i],
        )
        total += speed
    return total


@kernel
def _count_pairs(world: TrueState, ranges: MetricRanges, accumulator: MetricAccumulator) -> tuple[int, float]:
    """Number of pairs closer than r_coll, and smallest squared distance, m^2; also updates neighbours and status."""
    x, y, z = world.position
    ux, uy, uz = accumulator.heading
    neighbours, correlation = accumulator.neighbours, accumulator.correlation
    neighbours[:] = 0
    correlation[:] = 0
    cluster_sq, coll_sq = ranges.r_cluster**2, ranges.r_coll**2
    close, nearest_sq = 0, inf
    for i in range(x.size):
        for j in range(i + 1, x.size):
            distance_sq = (x[j] - x[i]) ** 2 + (y[j] - y[i]) ** 2 + (z[j] - z[i]) ** 2
            if distance_sq < cluster_sq:
                cosine = ux[i] * ux[j] + uy[i] * uy[j] + uz[i] * uz[j]
                neighbours[i] += 1
                neighbours[j] += 1
                correlation[i] += cosine
                correlation[j] += cosine
            nearest_sq = min(nearest_sq, distance_sq)
            if distance_sq < coll_sq:
                close += 1
                accumulator.status[i] |= CLOSE
                accumulator.status[j] |= CLOSE
    return close, nearest_sq


@kernel
def count_sample(
    world: TrueState, arena: NamedTuple, ranges: MetricRanges, counts: bool, accumulator: MetricAccumulator
) -> float:
    """Add a sample of the true state to the order parameters.

    Args:
        world: the true state.
        arena: the arena.
        ranges: distances of neighbours and collisions.
        counts: True if the sample enters the order parameters, False during the warm-up.
        accumulator: sums and buffers; updated.

    Returns:
        Smallest distance between two drones, m; infinite for one drone.
    """
    drones = accumulator.status.size
    outside, depth = _count_walls(world, arena, accumulator)
    speed = _count_speeds(world, accumulator)
    close, nearest_sq = _count_pairs(world, ranges, accumulator)
    correlation, disconnected, fewest = 0.0, 0, drones
    for i in range(drones):
        neighbours = accumulator.neighbours[i]
        fewest = min(fewest, neighbours)
        if neighbours == 0:
            disconnected += 1
        else:
            correlation += accumulator.correlation[i] / neighbours
    if counts:
        sums = accumulator.sums
        sums[0] += 1
        sums[1] += outside
        sums[2] += depth
        sums[3] += speed / drones
        sums[4] += correlation / drones
        sums[5] += 2 * close / (drones * max(drones - 1, 1))
        sums[6] += disconnected
        sums[7] += fewest
    return sqrt(nearest_sq)


@kernel
def write_running(accumulator: MetricAccumulator, out: NDArray[np.float64]) -> None:
    """Write the order parameters over the samples so far to `out`, in the order of `METRICS`; zeros without samples."""
    sums = accumulator.sums
    samples = max(sums[0], 1.0)
    out[0] = sums[2] / max(sums[1], 1.0)
    for k in range(1, len(METRICS)):
        out[k] = sums[2 + k] / samples
