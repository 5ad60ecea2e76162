"""Playback of flights: poses and colours of all drones as a function of time, with legend and events."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from moflock_mj.dynamics.airframe_models import load_airframe
from moflock_mj.errors import RenderError
from moflock_mj.metrics.events import FlightEvent
from moflock_mj.metrics.fitness import fitness_of
from moflock_mj.metrics.samples import Samples
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.visualization.colours import Legend, LegendEntry, colour_drones

TRAIL_SECONDS = 10.0
"""Duration of a trail, s of simulated time."""

_TRAIL_PERIOD = 0.5
"""Time between two corners of a trail, s; corners keep their places, so that a growing trail does not flicker."""

_MAX_FLIGHTS = 2
_TRACK_ARRAYS = ("t", "position", "quaternion", "velocity", "rgb", "objectives")


class Recorded(Protocol):
    """Interface of a recorded flight, from `fly` or from a log.

    A flight can also have `quaternion`, (T, N, 4), wxyz, from body to world; otherwise its drones are drawn upright. It
    can have `log`, a path whose stem names it.
    """

    @property
    def scenario(self) -> Scenario: ...

    @property
    def samples(self) -> Samples | None: ...

    @property
    def events(self) -> Sequence[FlightEvent]: ...


class Moment(NamedTuple):
    """State of a flock at one time.

    Attributes:
        position: positions, (N, 3), m, world.
        quaternion: quaternions, (N, 4), wxyz, from body to world.
        velocity: velocities, (N, 3), m/s, world.
        rgb: colours, (N, 3), u8.
    """

    position: NDArray[np.float32]
    quaternion: NDArray[np.float32]
    velocity: NDArray[np.float32]
    rgb: NDArray[np.uint8]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """One flight for drawing, with T samples of N drones.

    Attributes:
        name: name in the legend.
        airframe: airframe of the drones.
        t: times, (T,), s.
        position: positions, (T, N, 3), m, world.
        quaternion: quaternions, (T, N, 4), wxyz, from body to world.
        velocity: velocities, (T, N, 3), m/s, world.
        rgb: colours, (T, N, 3), u8.
        objectives: running F_1 and F_2, (T, 2).
    """

    name: str
    airframe: str
    t: NDArray[np.float64]
    position: NDArray[np.float32]
    quaternion: NDArray[np.float32]
    velocity: NDArray[np.float32]
    rgb: NDArray[np.uint8]
    objectives: NDArray[np.float64]

    @property
    def drones(self) -> int:
        return int(self.position.shape[1])

    def at(self, time: float) -> Moment:
        """Interpolate the flock linearly at a time, s; outside the samples it is the first or the last sample."""
        before, after, share = self._between(time)
        to = self.quaternion[after]
        # A quaternion and its negative are the same orientation; interpolate towards the closer one.
        side = np.where(np.sum(self.quaternion[before] * to, axis=-1, keepdims=True) < 0, -1, 1)
        quaternion = (1 - share) * self.quaternion[before] + share * side * to
        return Moment(
            position=(1 - share) * self.position[before] + share * self.position[after],
            quaternion=quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True),
            velocity=(1 - share) * self.velocity[before] + share * self.velocity[after],
            rgb=self.rgb[after if share > 0.5 else before],
        )

    def trail(self, time: float) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Trail of each drone up to a time, s: corners, (P + 1, N, 3), m, and colours between them, (P, N, 3)."""
        time = float(np.clip(time, self.t[0], self.t[-1]))
        oldest = max(time - TRAIL_SECONDS, float(self.t[0]))
        corners = np.arange(np.ceil(oldest / _TRAIL_PERIOD) * _TRAIL_PERIOD, time - 1e-9, _TRAIL_PERIOD)
        samples = np.clip(np.searchsorted(self.t, corners - 1e-9), 0, self.t.size - 1)
        head = self.at(time).position
        return np.concatenate([self.position[samples], head[None]]), self.rgb[samples]

    def _between(self, time: float) -> tuple[int, int, float]:
        """Samples before and after a time, and the share of the interval between them."""
        after = int(np.clip(np.searchsorted(self.t, time), 0, self.t.size - 1))
        before = max(after - 1, 0)
        span = float(self.t[after] - self.t[before])
        return before, after, float(np.clip((time - self.t[before]) / span, 0, 1)) if span else 0.0


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Playback:
    """One flight, or two in one arena, ready for drawing.

    Attributes:
        tracks: tracks of the flights.
        outline: corners of the arena in order, (M, 2), m, world.
        altitude: altitude of the flocks, m.
        v_flock: flocking speed, m/s.
        legend: legend of the colours.
        events: time, s, and text of each event, in order of time.
        followed: number of the drone of the first flight that comes closest to another one.
        drone_width: width of the largest airframe, m.
    """

    tracks: tuple[Track, ...]
    outline: NDArray[np.float64]
    altitude: float
    v_flock: float
    legend: Legend
    events: tuple[tuple[float, str], ...]
    followed: int
    drone_width: float

    @property
    def begin(self) -> float:
        """Time of the first sample, s."""
        return float(min(track.t[0] for track in self.tracks))

    @property
    def end(self) -> float:
        """Time of the last sample, s."""
        return float(max(track.t[-1] for track in self.tracks))

    def event_at(self, time: float, lasting: float) -> str:
        """Latest event within `lasting`, s, before a time, s, or an empty text."""
        recent = [text for when, text in self.events if time - lasting <= when <= time + 1e-9]
        return recent[-1] if recent else ""

    def save(self, folder: Path) -> None:
        """Save the playback for other processes: JSON, and one .npy file per array, which can be memory-mapped."""
        plain = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        plain["outline"] = self.outline.tolist()
        plain["tracks"] = [{"name": track.name, "airframe": track.airframe} for track in self.tracks]
        (folder / "playback.json").write_text(json.dumps(plain), encoding="utf-8")
        for number, track in enumerate(self.tracks):
            for name in _TRACK_ARRAYS:
                np.save(folder / f"{number}_{name}.npy", getattr(track, name), allow_pickle=False)

    @classmethod
    def load(cls, folder: Path) -> Playback:
        """Load a playback from `save`."""
        plain: dict[str, Any] = json.loads((folder / "playback.json").read_text(encoding="utf-8"))
        plain["tracks"] = tuple(
            Track(**about, **{name: np.load(folder / f"{number}_{name}.npy", mmap_mode="r") for name in _TRACK_ARRAYS})
            for number, about in enumerate(plain["tracks"])
        )
        plain["outline"] = np.array(plain["outline"])
        plain["legend"] = tuple(LegendEntry(*entry) for entry in plain["legend"])
        return cls(**plain)


def playback_of(
    flights: Recorded | Sequence[Recorded], *, colour: str = "speed", names: Sequence[str] | None = None
) -> Playback:
    """Prepare the playback of one flight, or of two to compare.

    Args:
        flights: one or two flights with samples, in one arena; each of two has its own colour.
        colour: quantity shown by the drones' colour, "speed" or "danger".
        names: names of the flights; by default those of their logs.

    Raises:
        RenderError: no samples, too many flights, different arenas, or an unknown colour.
    """
    flights = list(flights) if isinstance(flights, Sequence) else [flights]
    samples = _check_flights(flights)
    scenarios = [flight.scenario for flight in flights]
    names = _distinct(names or [_name(flight, number) for number, flight in enumerate(flights, start=1)])
    if len(names) != len(flights):
        raise RenderError(f"names: {len(names)} given for {len(flights)} flights")
    coloured = colour_drones(samples, scenarios, names, colour)
    tracks = tuple(_track(*parts) for parts in zip(flights, samples, names, coloured.rgb, strict=True))
    events = [
        (event.time_ns / 1e9, event.message if len(flights) == 1 else f"{name}: {event.message}")
        for name, flight in zip(names, flights, strict=True)
        for event in flight.events
    ]
    first = scenarios[0]
    return Playback(
        tracks=tracks,
        outline=first.arena.outline(),
        altitude=first.altitude,
        v_flock=first.v_flock,
        legend=coloured.legend,
        events=tuple(sorted(events)),
        followed=int(np.argmin(np.min(coloured.clearance[0], axis=0))),
        drone_width=max(2 * load_airframe(scenario.airframe).radius for scenario in scenarios),
    )


def _check_flights(flights: list[Recorded]) -> list[Samples]:
    """Check that flights can be drawn together; returns their samples."""
    if not 1 <= len(flights) <= _MAX_FLIGHTS:
        raise RenderError(f"flights: {len(flights)} given: there must be 1 to {_MAX_FLIGHTS}")
    arenas = {flight.scenario.arena for flight in flights}
    if len(arenas) > 1:
        first, second = (flight.scenario.arena.title for flight in flights)
        raise RenderError(f"flights: one is in a {first}, the other in a {second}: they must share one arena")
    samples = [flight.samples for flight in flights if flight.samples is not None and flight.samples.t.size]
    if len(samples) < len(flights):
        raise RenderError(
            "flights: one has no samples: it must have at least 1; fly with keep_samples, or read its log"
        )
    return samples


def _name(flight: Recorded, number: int) -> str:
    log = getattr(flight, "log", None)
    return Path(log).stem if log else f"flight {number}"


def _distinct(names: Sequence[str]) -> list[str]:
    """The names, numbered if two are equal."""
    if len(set(names)) == len(names):
        return list(names)
    return [f"{name} ({number})" for number, name in enumerate(names, start=1)]


def _track(flight: Recorded, samples: Samples, name: str, rgb: NDArray[np.uint8]) -> Track:
    quaternion = getattr(flight, "quaternion", None)
    if quaternion is None:
        quaternion = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*samples.position.shape[:2], 4))
    fitness = fitness_of(samples.order_parameters, flight.scenario)
    return Track(
        name=name,
        airframe=flight.scenario.airframe,
        t=samples.t,
        position=samples.position.astype(np.float32),
        quaternion=quaternion.astype(np.float32),
        velocity=samples.velocity.astype(np.float32),
        rgb=rgb,
        objectives=np.stack([fitness.F_1, fitness.F_2], axis=-1),
    )
