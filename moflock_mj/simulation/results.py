"""Results of a flight, and interface of the observers of a running one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from moflock_mj.errors import RenderError
from moflock_mj.metrics.events import FlightEvent
from moflock_mj.metrics.fitness import Fitness
from moflock_mj.metrics.order_parameters import OrderParameters
from moflock_mj.metrics.samples import SampleBuffer, Samples
from moflock_mj.metrics.tracking import MotionFigures
from moflock_mj.scenario.scenario import Scenario


def kept_samples(flight: AnyFlight) -> Samples:
    """Samples of a flight.

    Raises:
        RenderError: the flight has no samples.
    """
    if flight.samples is None or not flight.samples.t.size:
        raise RenderError(
            "samples: the flight has none: it must have at least 1; fly with keep_samples, or read its log"
        )
    return flight.samples


Progress = Callable[[float, Fitness], None]
"""Callback during a flight with the simulated time (s) and the running fitness."""


class FlightObserver(Protocol):
    """Observer of a running flight, such as a log or a live view."""

    @property
    def needs_states(self) -> bool:
        """True if the next samples must include complete states."""
        ...

    def store_state(self) -> None:
        """Store the complete state if it is due; called before the first samples and after each record."""
        ...

    def write(self, time_ns: NDArray[np.int64], record: SampleBuffer, events: list[FlightEvent]) -> None:
        """Process consecutive samples and their events."""
        ...

    def finish(self, record: SampleBuffer) -> None:
        """Process the end of the flight, at the last of these samples."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class BodyFigures(NamedTuple):
    """Figures of a rigid-body flight.

    Attributes:
        touched: number of drones that touched another one or the ground.
        lost: number of crashed drones, which end below half of the flight altitude.
        tilt_max: largest tilt of a body, rad.
        altitude_error_max: largest altitude error, m.
        saturated_share: fraction of the flight time of all drones with a rotor command at its limit.
        energy: energy consumed by all rotors, J.
    """

    touched: int
    lost: int
    tilt_max: float
    altitude_error_max: float
    saturated_share: float
    energy: float


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AnyFlight:
    """Data of a flight, either simulated or read from a log.

    Attributes:
        params: parameters of the policy.
        scenario: scenario of the flight.
        dynamics: "rigid_body" or "point_mass", or "deployed" for vehicles over MAVLink.
        seed: seed of all random numbers.
        flown: simulated time, or time in the flock of a deployed flight, s; less than the scenario's duration if the
            flight was stopped.
        order_parameters: order parameters of the flight.
        fitness: fitness of the order parameters.
        samples: samples of the flight; None if they were not kept.
        events: contacts, near misses, exits and faults, in order of time.
        log: path of the log, or None.
    """

    params: NamedTuple
    scenario: Scenario
    dynamics: str
    seed: int
    flown: float
    order_parameters: OrderParameters
    fitness: Fitness
    samples: Samples | None
    events: tuple[FlightEvent, ...]
    log: Path | None

    @property
    def flock_name(self) -> str:
        """Number and kind of the drones."""
        kinds = {"rigid_body": f"{self.scenario.airframe} rigid bodies", "point_mass": "point masses"}
        return f"{self.scenario.drones} {kinds.get(self.dynamics, 'vehicles over MAVLink')}"

    @property
    def complete(self) -> bool:
        """True if the flight lasted as long as its scenario."""
        return self.flown >= self.scenario.duration - 1e-9


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Flight(AnyFlight):
    """Result of a simulated flight.

    Attributes:
        motion: tracking errors and separation.
        body: figures of rigid bodies; None for point masses.
        wall_seconds: wall-clock time of the flight, s.
    """

    motion: MotionFigures
    body: BodyFigures | None
    wall_seconds: float
