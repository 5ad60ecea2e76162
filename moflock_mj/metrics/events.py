"""Events of a flight (contacts, near misses, exits, faults), detected in its samples."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moflock_mj.effects.fault_injection import NEVER, intervals_of
from moflock_mj.metrics.order_parameters import CLOSE, OUTSIDE, TOUCHED
from moflock_mj.metrics.samples import SampleBuffer
from moflock_mj.scenario.scenario import Scenario


class FlightEvent(NamedTuple):
    """Event of a flight: a contact, a near miss, an exit from the arena, a fault, the end of the flight.

    Attributes:
        time_ns: simulated time, ns.
        level: severity.
        message: one-line description.
        drone: number of the affected drone, or -1.
    """

    time_ns: int
    level: Literal["info", "warning", "error"]
    message: str
    drone: int = -1


def find_events(
    record: SampleBuffer, before: NDArray[np.uint8], time_ns: NDArray[np.int64], touched_with: NDArray[np.int64] | None
) -> list[FlightEvent]:
    """Detect the events in consecutive samples, in order of time.

    Args:
        record: K samples.
        before: (N,), status of the drones at the previous sample.
        time_ns: (K,), times of the samples, ns.
        touched_with: (N,), number of the drone in the first contact of each drone, or -1 for the ground.
    """
    status = np.vstack([before[None], record.status])
    begins = status[1:] & ~status[:-1]
    events = []
    for k, drone in np.argwhere(begins).tolist():
        flags, when = int(begins[k, drone]), int(time_ns[k])
        if flags & TOUCHED and touched_with is not None:
            other = int(touched_with[drone])
            touched = "the ground" if other < 0 else f"drone {other}"
            events.append(FlightEvent(when, "error", f"drone {drone} touched {touched}", drone))
        if flags & CLOSE:
            other, distance = _nearest(record.position[k], drone)
            if other > drone or not begins[k, other] & CLOSE:
                message = f"drones {drone} and {other} are {distance:.2f} m apart"
                events.append(FlightEvent(when, "warning", message, drone))
        if flags & OUTSIDE:
            events.append(FlightEvent(when, "info", f"drone {drone} left the arena", drone))
    return events


def fault_events(scenario: Scenario, period: float, after_ns: int, until_ns: int) -> list[FlightEvent]:
    """Beginnings and ends of faults within a time range, in order of time.

    Args:
        scenario: scenario with the faults.
        period: control interval, s.
        after_ns: lower end of the range, exclusive, ns.
        until_ns: upper end of the range, inclusive, ns.
    """
    events = []
    for fault in scenario.faults:
        drone = -1 if fault.drone is None else fault.drone
        for interval, ends in zip(intervals_of(fault, period), ("", " (over)"), strict=True):
            time_ns = interval * round(period * 1e9) if interval < NEVER else until_ns + 1
            if after_ns < time_ns <= until_ns:
                events.append(FlightEvent(time_ns, "warning", f"{fault.describe()}{ends}", drone))
    return sorted(events, key=lambda event: event.time_ns)


def _nearest(position: NDArray[np.float64], drone: int) -> tuple[int, float]:
    """Number of the nearest drone to a drone, and its distance, m; position: (N, 3), m."""
    distance = np.linalg.norm(position - position[drone], axis=1)
    distance[drone] = np.inf
    other = int(np.argmin(distance))
    return other, float(distance[other])
