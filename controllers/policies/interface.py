"""The interface of a velocity policy: its observation, its stage, and the description that the registry keeps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

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


class Parameter(NamedTuple):
    """One parameter of a policy.

    Attributes:
        name: as the named tuple of the policy and parameter files have it.
        unit: such as "m"; "1" for none.
        meaning: a few words.
        low: lower bound of a search.
        high: upper bound of a search.
        positive: whether the policy is defined for values over 0 only.
    """

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    positive: bool = False

    @property
    def label(self) -> str:
        """Name and unit, as an axis is labelled."""
        return self.name if self.unit == "1" else f"{self.name}, {self.unit.replace('^2', '²')}"


class FlightConditions(NamedTuple):
    """Numbers of a scenario and an airframe against which a policy's parameters are checked before a flight.

    Attributes:
        drones: how many.
        v_flock: m/s, cruise speed.
        v_max: m/s.
        r_comm: m, range of the radios.
        t_gps: s, interval of GPS fixes.
        delay: s, of communication, the links' included.
        tau: s, time constant of the velocity response.
        a_max: m/s^2, the largest horizontal acceleration of the airframe in this scenario.
        airframe: its name.
        arena_area: m^2.
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
    """The result of one check of a policy's parameters against the conditions of a flight.

    Attributes:
        name: of the check.
        good: whether it passes.
        value: the number that was checked.
        unit: of the value.
        limit: a few words.
        advice: how to pass it.
        fatal: whether a failure forbids the flight; otherwise it is a warning.
        whole_flock: whether it is about the flock in this scenario, not about the parameters alone.
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
    """What the rest of the project needs to know of a policy.

    Attributes:
        name: as parameter files, logs and the command line have it.
        params: the named tuple of its parameters; its type chooses the implementation of `desired_velocity`.
        parameters: in the order of the named tuple; those of a nested named tuple stand in its place.
        interaction_range: m, from the parameters and v_flock (m/s): drones closer than this form a cluster.
        dimensions: 2 for a horizontal velocity, 3 if the policy commands the climb rate too.
        checks: checks of its parameters before a flight.
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
