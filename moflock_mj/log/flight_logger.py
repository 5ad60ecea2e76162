"""Puts a flight of `fly` into a log: what precedes it, its samples, its states, its end."""

from __future__ import annotations

import datetime
import json
import platform
import subprocess
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from controllers.policies.registry import spec_of, values_of
from moflock_mj.dynamics.airframe_models import flock_spec, load_airframe
from moflock_mj.errors import LogError
from moflock_mj.log.encoder import Attachment, LogHeader, SampleBlock
from moflock_mj.log.foxglove_layout import BLUEPRINT_FILE, BLUEPRINT_NAME, LAYOUT_NAME, viewer_layout
from moflock_mj.log.schemas import LOG_VERSION, RUN_COPY
from moflock_mj.log.writer import FlightLog
from moflock_mj.metrics.events import FlightEvent
from moflock_mj.metrics.fitness import Fitness, fitness_of
from moflock_mj.metrics.order_parameters import OrderParameters
from moflock_mj.metrics.samples import SampleBuffer
from moflock_mj.parameters.points import dump_point
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulation.simulation import Simulation

_STATE_PERIOD = 10.0
"""Simulated seconds between two whole states."""

_MAX_DRAWN = 200
"""Drones up to which the attached model shows rotors and arms; composing these takes the square of their number."""


class FlightLogger:
    """A log that follows a flock; a context manager.

    A flight that ends early, by Ctrl-C or because a state is no longer finite, leaves a finished log with its last
    seconds in it; only a log that cannot be written is removed.

    Args:
        path: where it is written.
        simulation: what it follows, from the state that the flock is in now.
        origin: what the metadata say of where that state comes from.

    Raises:
        LogError: the log cannot be written.
    """

    def __init__(self, path: str | Path, simulation: Simulation, origin: Mapping[str, str]) -> None:
        self._simulation = simulation
        airframe = load_airframe(simulation.scenario.airframe)
        metadata = run_metadata(simulation) | dict(origin)
        self._log = FlightLog(
            path,
            LogHeader(
                metadata=metadata,
                attachments=flight_attachments(simulation.scenario, simulation.params, simulation.step, metadata),
                outline=simulation.arena.outline(),
                altitude=simulation.scenario.altitude,
                drones=simulation.scenario.drones,
                radius=airframe.radius,
            ),
        )
        self._next_state = simulation.time
        self._finished = False

    @property
    def needs_states(self) -> bool:
        """Always: a log holds whole states."""
        return True

    def write(self, time_ns: NDArray[np.int64], record: SampleBuffer, events: list[FlightEvent]) -> None:
        """Log some samples and the events in them."""
        for event in events:
            self._log.event(event)
        self._log.write(sample_block(time_ns, record, self._simulation.scenario))
        if self._simulation.body is None:
            # Point masses outrun the disk, and would lose more than a second to a kill.
            self._log.settle()

    def finish(self, record: SampleBuffer) -> None:
        """End the log with the figures of the last record."""
        phi = OrderParameters(*record.order_parameters[-1].tolist())
        fitness: Fitness = fitness_of(phi, self._simulation.scenario)
        self._finished = True
        self._log.finish(
            {
                "flown": repr(self._simulation.time),
                "order_parameters": json.dumps(phi._asdict()),
                "fitness": json.dumps(fitness._asdict()),
            }
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None or self._finished or isinstance(error, LogError):
            self._log.abort()
            return
        message = str(error) or "the flight was interrupted"
        self._log.event(FlightEvent(round(self._simulation.time * 1e9), "error", message))
        self._log.finish({"flown": repr(self._simulation.time), "error": message})

    def store_state(self) -> None:
        """Log the whole state if that is due; to be called before the first samples and after all others."""
        if self._simulation.time >= self._next_state - 1e-9:
            self._log.state(round(self._simulation.time * 1e9), self._simulation.snapshot())
            self._next_state += _STATE_PERIOD


def sample_block(time_ns: NDArray[np.int64], record: SampleBuffer, scenario: Scenario) -> SampleBlock:
    """Samples as a log holds them; time_ns: (K,), simulated time of each."""
    fitness = fitness_of(OrderParameters(*record.order_parameters.T), scenario)
    return SampleBlock(
        time_ns=time_ns,
        qpos=record.qpos,
        qvel=record.qvel,
        desired_velocity=record.desired.swapaxes(1, 2),
        status=record.status,
        order_parameters=record.order_parameters,
        fitness=np.stack(fitness, axis=1),
    )


def run_metadata(simulation: Simulation) -> dict[str, str]:
    """All that is needed to fly this flight again, and when and on what it was flown."""
    return {
        "scenario": simulation.scenario.to_toml(),
        "policy": spec_of(simulation.params).name,
        "parameters": json.dumps(values_of(simulation.params)),
        "dynamics": simulation.dynamics,
        "seed": str(simulation.seed),
        "step": repr(simulation.step),
        **circumstances(),
    }


def circumstances() -> dict[str, str]:
    """Versions, machine and time: what may explain a difference between two flights."""
    return {
        "moflock_version": version("moflock-mj"),
        "commit": source_commit(),
        "mujoco_version": version("mujoco"),
        "numpy_version": version("numpy"),
        "numba_version": version("numba"),
        "python_version": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "cpu": _cpu(),
        "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def flight_attachments(
    scenario: Scenario, params: NamedTuple, step: float, metadata: Mapping[str, str]
) -> tuple[Attachment, ...]:
    """The files inside a log: model, scenario, parameters, a copy of the metadata, layouts for viewers."""
    model = flock_spec(scenario.airframe, scenario.drones, step, visuals=scenario.drones <= _MAX_DRAWN)
    model.compile()
    return (
        Attachment("flock.xml", "application/xml", model.to_xml().encode()),
        Attachment("scenario.toml", "application/toml", scenario.to_toml().encode()),
        Attachment("parameters.json", "application/json", dump_point(params).encode()),
        Attachment(RUN_COPY, "application/json", json.dumps({"log_version": str(LOG_VERSION), **metadata}).encode()),
        Attachment(LAYOUT_NAME, "application/json", viewer_layout(2 * max(scenario.arena.extent()))),
        Attachment(BLUEPRINT_NAME, "application/gzip", BLUEPRINT_FILE.read_bytes()),
    )


def source_commit() -> str:
    """The commit of the source, or nothing for an installed package."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""
    try:
        command = ["git", "-C", str(root), "rev-parse", "HEAD"]
        return subprocess.run(command, capture_output=True, text=True, timeout=5, check=False).stdout.strip()
    except (OSError, subprocess.TimeoutExpired):
        return ""


def _cpu() -> str:
    """The processor's name: compiled code may round differently on another one."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
