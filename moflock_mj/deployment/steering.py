"""What a ground station commands each drone of a flock: the policy of the simulated flights, on what vehicles tell.

Compiled rooms stand beside the flight's own, where their cache follows the project's sources.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import entry_kernel, kernel
from controllers.geometry import clip_length
from controllers.policies.braking import braking_curve
from controllers.policies.interface import Sensed, SpeedLimits, desired_velocity
from controllers.policies.vasarhelyi import FlockingParams
from moflock_mj.metrics.order_parameters import Tally, Yardstick, cluster_range, count_sample, write_running
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.world.square import SquareArena
from moflock_mj.world.state import World
from moflock_mj.world.walls import locate_walls

_BRAKING = 3.0
"""m/s^2, with which a drone stops before one that it keeps off."""
_SLOPE = 1.0
"""1/s, of the last metres of that."""


class Flockmates(NamedTuple):
    """Which drones fly by the policy, and which others they keep off.

    Attributes:
        agents: (N,), 1 for a drone of the flock: it flies by the policy, and the policy of the others heeds it.
        shunned: (N,), 1 for one that has left the flock and is in its layer: it is no agent to anybody, but nobody
            comes nearer to it than `keep_off`.
        keep_off: (N,), m, around each shunned one.
    """

    agents: NDArray[np.uint8]
    shunned: NDArray[np.uint8]
    keep_off: NDArray[np.float64]

    @classmethod
    def none(cls, drones: int) -> Flockmates:
        return cls(np.zeros(drones, np.uint8), np.zeros(drones, np.uint8), np.zeros(drones))


@entry_kernel
def steer(
    params: NamedTuple,
    limits: SpeedLimits,
    arena: NamedTuple,
    r_comm: float,
    mates: Flockmates,
    sensed: Sensed,
    out: NDArray[np.float64],
) -> None:
    """Write the velocity of each agent, and zero for the others.

    Args:
        params: the policy's parameters, whose type chooses the policy.
        limits: speeds of the scenario, m/s.
        arena: where the walls are.
        r_comm: m, up to which drones heed each other.
        mates: who flies by the policy.
        sensed: positions and velocities as telemetry has them, own and heard; neighbours and walls are written.
        out: (2, N), m/s, world; written.
    """
    _find_agents(r_comm, mates, sensed)
    locate_walls(arena, sensed.own_position, sensed.wall_distance, sensed.wall_normal)
    desired_velocity(params, limits, sensed, out)
    for i in range(out.shape[1]):
        if mates.agents[i]:
            _keep_off(limits, mates, sensed, i, out)
        else:
            out[0, i] = out[1, i] = 0.0


def compile_policy(params: FlockingParams, scenario: Scenario) -> None:
    """Compile what steers and judges a flock, which takes some 20 s once on a machine, before anybody listens."""
    arena, world = SquareArena(scenario.arena_side), World.at_rest(2)
    limits = SpeedLimits(scenario.v_flock, scenario.v_max, scenario.v_rep_max)
    sensed = Sensed.empty(2, arena.walls)
    steer(params, limits, arena, scenario.r_comm, Flockmates.none(2), sensed, np.zeros((2, 2)))
    yardstick = Yardstick(cluster_range(params, scenario.v_flock), scenario.r_coll)
    judge(world, arena, yardstick, False, Tally.empty(2, arena.walls), np.zeros(6))


@kernel
def _find_agents(r_comm: float, mates: Flockmates, sensed: Sensed) -> None:
    """List whom each agent heeds: the other agents within r_comm."""
    x, y = sensed.own_position
    sensed.neighbour_count[:] = 0
    for i in range(x.size):
        for j in range(x.size):
            if i != j and mates.agents[i] and mates.agents[j]:
                rx, ry = sensed.heard_position[0, j] - x[i], sensed.heard_position[1, j] - y[i]
                if rx * rx + ry * ry < r_comm * r_comm:
                    sensed.neighbours[i, sensed.neighbour_count[i]] = j
                    sensed.neighbour_count[i] += 1


@kernel
def _keep_off(limits: SpeedLimits, mates: Flockmates, sensed: Sensed, i: int, out: NDArray[np.float64]) -> None:
    """Cut drone i's velocity towards each shunned drone to what it can brake in time; too near, make it go away."""
    vx, vy = out[0, i], out[1, i]
    for j in range(out.shape[1]):
        if not mates.shunned[j]:
            continue
        rx = sensed.heard_position[0, j] - sensed.own_position[0, i]
        ry = sensed.heard_position[1, j] - sensed.own_position[1, i]
        distance = sqrt(rx * rx + ry * ry)
        if distance == 0:
            continue
        nx, ny = rx / distance, ry / distance
        room = distance - mates.keep_off[j]
        allowed = braking_curve(room, _BRAKING, _SLOPE) if room > 0 else max(_SLOPE * room, -limits.v_rep_max)
        # One that comes nearer by itself leaves less; one that flees is not followed faster.
        allowed += min(nx * sensed.heard_velocity[0, j] + ny * sensed.heard_velocity[1, j], 0.0)
        excess = vx * nx + vy * ny - allowed
        if excess > 0:
            vx -= excess * nx
            vy -= excess * ny
    out[0, i], out[1, i] = clip_length(vx, vy, limits.v_max)


@entry_kernel
def judge(
    world: World, arena: NamedTuple, yardstick: Yardstick, counts: bool, tally: Tally, out: NDArray[np.float64]
) -> float:
    """Judge one moment as a simulated flight's samples are judged.

    Args:
        world: as telemetry has it.
        arena: where the walls are.
        yardstick: distances by which it is judged, m.
        counts: whether it enters the order parameters.
        tally: sums; written.
        out: (6,), the running order parameters; written.

    Returns:
        The smallest distance between two drones, m.
    """
    nearest = count_sample(world, arena, yardstick, counts, tally)
    write_running(tally, out)
    return nearest
