"""Events of a flight: what a pilot would want to be told of, found in the samples."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moflock_mj.effects.fault_injection import NEVER, intervals_of
from moflock_mj.metrics.order_parameters import CLOSE, OUTSIDE, TOUCHED
from moflock_mj.metrics.samples import SampleBuffer
from moflock_mj.scenario.scenario import Scenario


class FlightEvent(NamedTuple):
    """Something worth telling: a touch, a near miss, a breach of the arena, a fault, the end of the flight.

    Attributes:
        time_ns: simulated time, ns.
        level: how bad it is.
        message: one line.
        drone: the drone it happened to, or -1.
    """

    time_ns: int
    level: Literal["info", "warning", "error"]
    message: str
    drone: int = -1


def find_events(
    record: SampleBuffer, before: NDArray[np.uint8], time_ns: NDArray[np.int64], touched_with: NDArray[np.int64] | None
) -> list[FlightEvent]:
    """Events of some samples, in order of time.

    Args:
        record: K samples.
        before: (N,), the drones' status at the sample before them.
        time_ns: (K,), their times.
        touched_with: (N,), what each drone that touched something has touched: a drone's number, or -1, the ground.
    """
    status = np.vstack([before[None], record.status])
    begins = status[1:] & ~status[:-1]
    events = []
    for k, drone in np.argwhere(begins).tolist():
        flags, when = int(begins[k, drone]), int(time_ns[k])
        if flags & TOUCHED and touched_with is not None:
            other = int(touched_with[drone])
            what = "the ground" if other < 0 else f"drone {other}"
            events.append(FlightEvent(when, "error", f"drone {drone} touched {what}", drone))
        if flags & CLOSE:
            other, distance = _nearest(record.position[k], drone)
            if other > drone or not begins[k, other] & CLOSE:
                message = f"drones {drone} and {other} are {distance:.2f} m apart"
                events.append(FlightEvent(when, "warning", message, drone))
        if flags & OUTSIDE:
            events.append(FlightEvent(when, "info", f"drone {drone} left the arena", drone))
    return events


def fault_events(scenario: Scenario, period: float, after_ns: int, until_ns: int) -> list[FlightEvent]:
    """Beginnings and ends of faults, in order of time.

    Args:
        scenario: says which there are.
        period: s, of a beat.
        after_ns: events of this time and before are left out.
        until_ns: and so are those after this one.
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
    """The drone nearest to another, and how far it is, m; position: (N, 3), m."""
    distance = np.linalg.norm(position - position[drone], axis=1)
    distance[drone] = np.inf
    other = int(np.argmin(distance))
    return other, float(distance[other])
