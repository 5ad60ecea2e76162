"""The result of a flight, and the observers of a running one."""

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
    """A flight's samples.

    Raises:
        RenderError: it has none.
    """
    if flight.samples is None or not flight.samples.t.size:
        raise RenderError("samples: the flight has none, must have 1 or more; fly with keep_samples, or read its log")
    return flight.samples


Progress = Callable[[float, Fitness], None]
"""Told, now and then, the simulated time in s and the running fitness."""


class FlightObserver(Protocol):
    """Something that is told of a flight while it is flown: its log, a live view."""

    @property
    def needs_states(self) -> bool:
        """Whether the next samples are to be flown with whole states."""
        ...

    def store_state(self) -> None:
        """Keep the whole state, if that is due: before the first samples and after each chunk."""
        ...

    def write(self, time_ns: NDArray[np.int64], record: SampleBuffer, events: list[FlightEvent]) -> None:
        """Take some samples and the events in them."""
        ...

    def finish(self, record: SampleBuffer) -> None:
        """Take note of the flight's end, at the last of these samples."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class BodyFigures(NamedTuple):
    """What only a rigid body has.

    Attributes:
        touched: drones that touched another one or the ground.
        lost: drones that have come down: at the end they are below half of the flock's altitude.
        tilt_max: rad, largest tilt of a body.
        altitude_error_max: m.
        saturated_share: share of the drones' time in which a rotor was commanded to its limit.
        energy: J, that all rotors together took.
    """

    touched: int
    lost: int
    tilt_max: float
    altitude_error_max: float
    saturated_share: float
    energy: float


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class AnyFlight:
    """What is known of a flight, whether it was flown just now or is read from its log.

    Attributes:
        params: the policy's parameters.
        scenario: what was flown.
        dynamics: "rigid_body" or "point_mass", or "deployed" for vehicles over MAVLink.
        seed: of all random numbers.
        flown: s, simulated, or of a deployed flight in the flock; less than the scenario's duration if the flight
            was stopped.
        order_parameters: over the flight.
        fitness: of them.
        samples: the flight; None if they were not kept.
        events: touches, near misses, breaches, faults, in order of time.
        log: where it is logged, or None.
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
        """What flew, and how many."""
        kinds = {"rigid_body": f"{self.scenario.airframe} rigid bodies", "point_mass": "point masses"}
        return f"{self.scenario.drones} {kinds.get(self.dynamics, 'vehicles over MAVLink')}"

    @property
    def complete(self) -> bool:
        """Whether the flight lasted as long as its scenario."""
        return self.flown >= self.scenario.duration - 1e-9


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Flight(AnyFlight):
    """A flight that is over.

    Attributes:
        motion: how well it was flown.
        body: what only rigid bodies have; None for point masses.
        wall_seconds: how long it took.
    """

    motion: MotionFigures
    body: BodyFigures | None
    wall_seconds: float
