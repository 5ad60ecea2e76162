"""Observer that logs a flight of `fly`: header, samples, states and result."""

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
"""Simulated seconds between two complete states."""

_MAX_DRAWN = 200
"""Largest flock whose attached model includes visual geoms; the cost of composing them is quadratic in the drones."""


class FlightLogger:
    """Log of a running simulation; a context manager.

    A flight that ends early, by Ctrl-C or a state that is no longer finite, leaves a complete log up to its end. The
    log is removed only if it cannot be written.

    Args:
        path: path of the log.
        simulation: the simulation, logged from its present state on.
        origin: metadata about the source of that state.

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
        """True: a log contains complete states."""
        return True

    def write(self, time_ns: NDArray[np.int64], record: SampleBuffer, events: list[FlightEvent]) -> None:
        """Log consecutive samples and their events."""
        for event in events:
            self._log.event(event)
        self._log.write(sample_block(time_ns, record, self._simulation.scenario))
        if self._simulation.body is None:
            # Point masses run faster than the disk: a killed program would lose more than a second.
            self._log.settle()

    def finish(self, record: SampleBuffer) -> None:
        """Finish the log with the figures of the last record."""
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
        """Log the complete state if it is due; called before the first samples and after each record."""
        if self._simulation.time >= self._next_state - 1e-9:
            self._log.state(round(self._simulation.time * 1e9), self._simulation.snapshot())
            self._next_state += _STATE_PERIOD


def sample_block(time_ns: NDArray[np.int64], record: SampleBuffer, scenario: Scenario) -> SampleBlock:
    """Convert samples to the form of a log; time_ns: (K,), simulated times, ns."""
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
    """Inputs of the flight, for repetition, and time, versions and machine."""
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
    """Time, versions and machine, which may explain a difference between two flights."""
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
    """Files attached to a log: model, scenario, parameters, a copy of the metadata, layouts for viewers."""
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
    """Commit of the source; empty for an installed package."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""
    try:
        command = ["git", "-C", str(root), "rev-parse", "HEAD"]
        return subprocess.run(command, capture_output=True, text=True, timeout=5, check=False).stdout.strip()
    except (OSError, subprocess.TimeoutExpired):
        return ""


def _cpu() -> str:
    """Name of the processor, because compiled code may round differently on another one."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
