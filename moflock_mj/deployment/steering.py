"""Velocity commands of a deployed flock: the policy of the simulated flights, applied to telemetry."""

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
"""Deceleration before an avoided drone, m/s^2."""
_SLOPE = 1.0
"""Slope of the linear part of the braking curve, 1/s."""


class FlockRoles(NamedTuple):
    """Roles of the drones in the policy.

    Attributes:
        agents: 1 for a drone of the flock, which flies with the policy and is a neighbour of others, (N,).
        avoided: 1 for a drone in the flock's layer that does not belong to the flock: it is no neighbour, but the
            flock keeps the distance `keep_off`, (N,).
        keep_off: distance to keep from each avoided drone, (N,), m.
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
    """Write the velocity of each agent, and zero for other drones.

    Args:
        params: parameters of the policy; their type selects the policy.
        limits: speed limits of the scenario, m/s.
        arena: arena with the walls.
        r_comm: communication range, m.
        roles: roles of the drones.
        observation: own and received positions and velocities from telemetry; neighbours and walls are written.
        out: velocities, (2, N), m/s, world; written.
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
    """Compile the policy and the metrics, which takes about 20 s once per machine, before vehicles are connected."""
    setup, walls = FlightSetup.resolve(params, scenario), scenario.arena.walls
    observation = Observation.empty(2, walls)
    steer(setup.params, setup.limits, setup.arena, scenario.r_comm, FlockRoles.none(2), observation, np.zeros((2, 2)))
    accumulator = MetricAccumulator.empty(2, walls)
    score(TrueState.at_rest(2), setup.arena, setup.ranges, False, accumulator, np.zeros(len(METRICS)))


@kernel
def _find_agents(r_comm: float, roles: FlockRoles, observation: Observation) -> None:
    """List the neighbours of each agent: the other agents within r_comm."""
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
    """Limit drone i's velocity towards each avoided drone so that it can brake in time; too near, move it away."""
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
        margin = distance - roles.keep_off[j]
        allowed = braking_curve(margin, _BRAKING, _SLOPE) if margin > 0 else max(_SLOPE * margin, -limits.v_rep_max)
        # An approaching drone reduces the allowed velocity; a receding one does not increase it.
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
    """Add one sample to the order parameters, in the same way as a simulated flight.

    Args:
        world: positions and velocities from telemetry.
        arena: arena with the walls.
        ranges: distances of the order parameters, m.
        counts: whether the sample enters the order parameters.
        accumulator: sums; written.
        out: running order parameters, (6,); written.

    Returns:
        The smallest distance between two drones, m.
    """
    nearest = count_sample(world, arena, ranges, counts, accumulator)
    write_running(accumulator, out)
    return nearest
