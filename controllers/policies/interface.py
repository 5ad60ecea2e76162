"""Interface of a velocity policy: its observation, its stage, and its entry in the registry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.compiling import stage


class Observation(NamedTuple):
    """Inputs of the policies of N drones; horizontal, world frame.

    Attributes:
        own_position: (2, N), measured own position, m, with the GPS error of the drone.
        own_velocity: (2, N), measured own velocity, m/s, with the GPS error of the drone.
        received_position: (2, M), position of drone j as received from j, m: delayed, with the GPS error of j. M is N,
            or a multiple of N where packets are kept: column j + a N holds the packet of a fixes earlier, extrapolated.
        received_velocity: (2, M), velocity of drone j as received from j, m/s.
        neighbours: (N, N), row i begins with the columns of the drones from which i receives packets.
        neighbour_count: (N,), number of valid entries in each row of `neighbours`.
        wall_distance: (W, N), distance from the measured position to each wall, m, negative beyond the wall.
        wall_normal: (W, 2, N), unit normal of each wall, into the arena.
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
        """Zero arrays for the given numbers of drones, walls and kept earlier packets."""
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


class Parameter(NamedTuple):
    """A parameter of a policy.

    Attributes:
        name: name in the policy's named tuple and in parameter files.
        unit: unit, such as "m"; "1" for none.
        meaning: short description.
        low: lower bound of a search.
        high: upper bound of a search.
        positive: True if the policy is defined only for values over 0.
    """

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    positive: bool = False

    @property
    def label(self) -> str:
        """Label of an axis: name and unit."""
        return self.name if self.unit == "1" else f"{self.name}, {self.unit.replace('^2', '²')}"


class FlightConditions(NamedTuple):
    """Figures of a scenario and an airframe, for the checks of a policy's parameters before a flight.

    Attributes:
        drones: number of drones.
        v_flock: cruise speed, m/s.
        v_max: largest desired speed, m/s.
        r_comm: range of the radios, m.
        t_gps: interval of GPS fixes, s.
        delay: communication delay including that of the links, s.
        tau: time constant of the velocity response, s.
        a_max: largest horizontal acceleration of the airframe in this scenario, m/s^2.
        airframe: name of the airframe.
        arena_area: area of the arena, m^2.
    """

    drones: int
    v_flock: float
    v_max: float
    r_comm: float
    t_gps: float
    delay: float
    tau: float
    a_max: float
    airframe: str
    arena_area: float


class PolicyCheck(NamedTuple):
    """Result of a check of a policy's parameters against the conditions of a flight.

    Attributes:
        name: name of the check.
        good: True if the check passes.
        value: checked value.
        unit: unit of the value.
        limit: limit in words.
        advice: remedy for a failure.
        fatal: True if a failure forbids the flight; otherwise it is a warning.
        whole_flock: True if the check depends on the flock and the scenario, not on the parameters alone.
    """

    name: str
    good: bool
    value: float
    unit: str
    limit: str
    advice: str
    fatal: bool = True
    whole_flock: bool = False


def _no_checks(params: Any, conditions: FlightConditions) -> Sequence[PolicyCheck]:  # noqa: ARG001
    return ()


class PolicySpec(NamedTuple):
    """Entry of a policy in the registry.

    Attributes:
        name: name in parameter files, in logs and on the command line.
        params: named tuple type of the parameters; selects the implementation of `desired_velocity`.
        parameters: the parameters in the order of the named tuple, with those of a nested named tuple in its place.
        interaction_range: function of the parameters and v_flock (m/s) that returns the distance (m) within which
            drones form a cluster.
        dimensions: 2 for a horizontal velocity, 3 if the policy also commands the climb rate.
        checks: function that checks the parameters before a flight.
    """

    name: str
    params: Callable[..., Any]
    parameters: tuple[Parameter, ...]
    interaction_range: Callable[[Any, float], float]
    dimensions: int = 2
    checks: Callable[[Any, FlightConditions], Sequence[PolicyCheck]] = _no_checks

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return tuple(parameter.name for parameter in self.parameters)


class SpeedLimits(NamedTuple):
    """Speed limits of the scenario, m/s."""

    v_flock: float
    v_max: float
    v_rep_max: float


@stage
def desired_velocity(
    params: NamedTuple, limits: SpeedLimits, observation: Observation, out: NDArray[np.float64]
) -> None:
    """Write the desired velocity of each drone.

    Args:
        params: parameters of the policy.
        limits: speed limits of the scenario, m/s.
        observation: observations of all drones.
        out: (2, N), desired velocities, m/s, world; written.
    """
    raise NotImplementedError
