"""Names of flights, and the captions of their figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from controllers.policies.target_tracking import TargetTrackingParams
from moflock_mj.parameters.points import load_point, point_names
from moflock_mj.simulation.results import AnyFlight, kept_samples

_DYNAMICS = {"rigid_body": "rigid bodies", "point_mass": "point masses", "deployed": "deployed"}


def flight_names(flights: Sequence[AnyFlight]) -> list[str]:
    """Distinct names of flights: their points, else with dynamics or seeds, else their logs, else numbers."""
    points = [_point_name(flight.params) for flight in flights]
    kinds = [f"{point}, {_DYNAMICS[flight.dynamics]}" for point, flight in zip(points, flights, strict=True)]
    seeds = [f"{point}, seed {flight.seed}" for point, flight in zip(points, flights, strict=True)]
    logs = [Path(flight.log).stem if flight.log else "" for flight in flights]
    for names in (points, kinds, seeds, logs):
        if len(set(names)) == len(flights):
            return names
    return [f"{point} ({number})" for number, point in enumerate(points, start=1)]


def conditions(flight: AnyFlight) -> str:
    """Conditions of a flight: flock, arena, duration and seed."""
    scenario, flown = flight.scenario, kept_samples(flight).t[-1]
    lasting = f"{flown:g} s" if flown >= scenario.duration - 1e-6 else f"{flown:g} of {scenario.duration:g} s"
    params = flight.params
    target = (
        f", target at ({params.target_x:g}, {params.target_y:g}) m" if isinstance(params, TargetTrackingParams) else ""
    )
    return f"{flight.flock_name}, {scenario.arena.title}{target}, {lasting}, seed {flight.seed}"


def figures(flight: AnyFlight) -> str:
    """The two objectives, and the numbers of contacts and near misses."""
    touches = sum(event.level == "error" for event in flight.events)
    close = sum(event.level == "warning" for event in flight.events)
    incidents = f"{_count(touches, 'contact', 'contacts')}, {_count(close, 'near miss', 'near misses')}"
    return f"F_1 = {flight.fitness.F_1:.3f}, F_2 = {flight.fitness.F_2:.3f}; {incidents}"


def _point_name(params: NamedTuple) -> str:
    """Name of a named point, else "own point"."""
    base = params.base if isinstance(params, TargetTrackingParams) else params
    names = [name for name in point_names() if load_point(name) == base]
    return f"point {names[0]}" if names and len(names[0]) == 1 else names[0] if names else "own point"


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"
