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
from controllers.policies.interface import Observation, SpeedLimits, desired_velocity
from moflock_mj.metrics.catalogue import METRICS
from moflock_mj.metrics.order_parameters import (
    MetricAccumulator,
    MetricRanges,
    count_sample,
    write_running,
)
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulation.setup import FlightSetup
from moflock_mj.world.state import TrueState
from moflock_mj.world.walls import locate_walls

_BRAKING = 3.0
"""m/s^2, with which a drone stops before one that it keeps off."""
_SLOPE = 1.0
"""1/s, of the last metres of that."""


class FlockRoles(NamedTuple):
    """Which drones fly by the policy, and which others they keep off.

    Attributes:
        agents: (N,), 1 for a drone of the flock: it flies by the policy, and the policy of the others heeds it.
        avoided: (N,), 1 for one that has left the flock and is in its layer: it is no agent to anybody, but nobody
            comes nearer to it than `keep_off`.
        keep_off: (N,), m, around each shunned one.
    """

    agents: NDArray[np.uint8]
    avoided: NDArray[np.uint8]
    keep_off: NDArray[np.float64]

    @classmethod
    def none(cls, drones: int) -> FlockRoles:
        return cls(np.zeros(drones, np.uint8), np.zeros(drones, np.uint8), np.zeros(drones))


@entry_kernel
def steer(
    params: NamedTuple,
    limits: SpeedLimits,
    arena: NamedTuple,
    r_comm: float,
    roles: FlockRoles,
    observation: Observation,
    out: NDArray[np.float64],
) -> None:
    """Write the velocity of each agent, and zero for the others.

    Args:
        params: the policy's parameters, whose type chooses the policy.
        limits: speeds of the scenario, m/s.
        arena: where the walls are.
        r_comm: m, up to which drones heed each other.
        roles: who flies by the policy.
        observation: positions and velocities as telemetry has them, own and heard; neighbours and walls are written.
        out: (2, N), m/s, world; written.
    """
    _find_agents(r_comm, roles, observation)
    locate_walls(arena, observation.own_position, observation.wall_distance, observation.wall_normal)
    desired_velocity(params, limits, observation, out)
    for i in range(out.shape[1]):
        if roles.agents[i]:
            _keep_off(limits, roles, observation, i, out)
        else:
            out[0, i] = out[1, i] = 0.0


def compile_policy(params: NamedTuple, scenario: Scenario) -> None:
    """Compile what steers and judges a flock, which takes some 20 s once on a machine, before anybody listens."""
    setup, walls = FlightSetup.resolve(params, scenario), scenario.arena.walls
    observation = Observation.empty(2, walls)
    steer(setup.params, setup.limits, setup.arena, scenario.r_comm, FlockRoles.none(2), observation, np.zeros((2, 2)))
    accumulator = MetricAccumulator.empty(2, walls)
    score(TrueState.at_rest(2), setup.arena, setup.ranges, False, accumulator, np.zeros(len(METRICS)))


@kernel
def _find_agents(r_comm: float, roles: FlockRoles, observation: Observation) -> None:
    """List whom each agent heeds: the other agents within r_comm."""
    x, y = observation.own_position
    observation.neighbour_count[:] = 0
    for i in range(x.size):
        for j in range(x.size):
            if i != j and roles.agents[i] and roles.agents[j]:
                rx, ry = observation.received_position[0, j] - x[i], observation.received_position[1, j] - y[i]
                if rx * rx + ry * ry < r_comm * r_comm:
                    observation.neighbours[i, observation.neighbour_count[i]] = j
                    observation.neighbour_count[i] += 1


@kernel
def _keep_off(
    limits: SpeedLimits, roles: FlockRoles, observation: Observation, i: int, out: NDArray[np.float64]
) -> None:
    """Cut drone i's velocity towards each shunned drone to what it can brake in time; too near, make it go away."""
    vx, vy = out[0, i], out[1, i]
    for j in range(out.shape[1]):
        if not roles.avoided[j]:
            continue
        rx = observation.received_position[0, j] - observation.own_position[0, i]
        ry = observation.received_position[1, j] - observation.own_position[1, i]
        distance = sqrt(rx * rx + ry * ry)
        if distance == 0:
            continue
        nx, ny = rx / distance, ry / distance
        room = distance - roles.keep_off[j]
        allowed = braking_curve(room, _BRAKING, _SLOPE) if room > 0 else max(_SLOPE * room, -limits.v_rep_max)
        # One that comes nearer by itself leaves less; one that flees is not followed faster.
        allowed += min(nx * observation.received_velocity[0, j] + ny * observation.received_velocity[1, j], 0.0)
        excess = vx * nx + vy * ny - allowed
        if excess > 0:
            vx -= excess * nx
            vy -= excess * ny
    out[0, i], out[1, i] = clip_length(vx, vy, limits.v_max)


@entry_kernel
def score(
    world: TrueState,
    arena: NamedTuple,
    ranges: MetricRanges,
    counts: bool,
    accumulator: MetricAccumulator,
    out: NDArray[np.float64],
) -> float:
    """Judge one moment as a simulated flight's samples are judged.

    Args:
        world: as telemetry has it.
        arena: where the walls are.
        ranges: distances by which it is judged, m.
        counts: whether it enters the order parameters.
        accumulator: sums; written.
        out: (6,), the running order parameters; written.

    Returns:
        The smallest distance between two drones, m.
    """
    nearest = count_sample(world, arena, ranges, counts, accumulator)
    write_running(accumulator, out)
    return nearest
