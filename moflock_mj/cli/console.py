"""Terminal output of a simulated flight (progress bar, tables, JSON), and the handling of Ctrl-C."""

from __future__ import annotations

import contextlib
import datetime
import json
import math
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
from rich.table import Table
from rich.text import Text

from moflock_mj.metrics.catalogue import METRICS
from moflock_mj.metrics.fitness import Fitness
from moflock_mj.metrics.order_parameters import OrderParameters
from moflock_mj.parameters.points import point_names
from moflock_mj.simulation.results import Flight
from moflock_mj.simulation.results import Progress as ProgressCallback


def log_path(option: str | None, point: str, dynamics: str, seed: int) -> Path | None:
    """Path of a flight's log: the given file, None for "none", else a new file in the given folder or in logs/."""
    if option == "none":
        return None
    folder = Path("logs") if option is None else Path(option)
    if option is not None and not option.endswith("/") and not folder.is_dir():
        return folder if folder.suffix == ".mcap" else Path(f"{option}.mcap")
    now = datetime.datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
    name = point if point in point_names() else Path(point).stem
    return folder / f"{now}-{name}-{dynamics}-seed{seed}.mcap"


class _Rate(ProgressColumn):
    """Column with the ratio of simulated time to wall time."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.completed / task.elapsed:.0f}x real time" if task.elapsed else "")


@contextlib.contextmanager
def flight_progress(duration: float) -> Iterator[ProgressCallback]:
    """Show simulated time, real-time factor and running fitness on stderr, if that is a terminal."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f} s"),
        _Rate(),
        TextColumn("{task.fields[fitness]}"),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("preparing (the first flight compiles for about 20 s)", total=duration, fitness="")

        def report(flown: float, fitness: Fitness) -> None:
            if not bar.tasks[0].completed:
                bar.reset(task, description="flying")
            bar.update(task, completed=flown, fitness=f"F_1 {fitness.F_1:.3f}  F_2 {fitness.F_2:.3f}")

        yield report


@contextlib.contextmanager
def share_progress(description: str) -> Iterator[Callable[[float], None]]:
    """Show the completed share, from 0 to 1, as a progress bar on stderr, if that is a terminal."""
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(description, total=1.0)
        yield lambda share: bar.update(task, completed=share)


@contextlib.contextmanager
def stop_on_interrupt() -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C (or SIGTERM) into a request to stop; the second one raises KeyboardInterrupt."""
    requested = threading.Event()

    def note(signal_number: int, frame: FrameType | None) -> None:  # noqa: ARG001
        if requested.is_set():
            raise KeyboardInterrupt
        requested.set()

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield requested.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def print_flight(flight: Flight, *, as_json: bool) -> None:
    """Print a flight's results to stdout."""
    if as_json:
        print(json.dumps(flight_summary(flight), indent=1))
        return
    console = Console()
    console.print(_head_line(flight), highlight=False)
    console.print(figures_table(flight))
    for line in _closing_lines(flight):
        console.print(line, highlight=False, soft_wrap=True)


def flight_summary(flight: Flight) -> dict[str, Any]:
    """A flight's results as JSON values."""
    return {
        "dynamics": flight.dynamics,
        "seed": flight.seed,
        "drones": flight.scenario.drones,
        "duration": flight.scenario.duration,
        "flown": flight.flown,
        "complete": flight.complete,
        "order_parameters": flight.order_parameters._asdict(),
        "fitness": flight.fitness._asdict(),
        "motion": flight.motion._asdict(),
        "body": flight.body._asdict() if flight.body else None,
        "events": len(flight.events),
        "wall_seconds": flight.wall_seconds,
        "log": str(flight.log) if flight.log else None,
    }


def _head_line(flight: Flight) -> str:
    rate = flight.flown / flight.wall_seconds
    return (
        f"{flight.flock_name}, {flight.flown:g} s in {flight.wall_seconds:.1f} s ({rate:.0f}x real time), "
        f"seed {flight.seed}"
    )


class Scored(Protocol):
    """Anything with order parameters and fitness."""

    @property
    def order_parameters(self) -> OrderParameters: ...

    @property
    def fitness(self) -> Fitness: ...


def figures_table(flight: Scored) -> Table:
    """Table of a flight's order parameters and fitness."""
    table = Table("order parameter", "value", "", "fitness", "value")
    for column in (1, 4):
        table.columns[column].justify = "right"
    for metric, value in zip(METRICS, flight.order_parameters, strict=True):
        fitness = getattr(flight.fitness, metric.fitness)
        table.add_row(metric.symbol, f"{value:.5g}", metric.unit, metric.fitness_symbol, f"{fitness:.3f}")
    table.add_section()
    for name in ("F_1", "F_2", "product"):
        table.add_row("", "", "", name, f"{getattr(flight.fitness, name):.3f}")
    return table


def _closing_lines(flight: Flight) -> list[str]:
    lines = []
    if flight.body:
        body = flight.body
        lines.append(
            f"drones in contact: {body.touched} of {flight.scenario.drones}, {body.lost} lost; largest tilt "
            f"{math.degrees(body.tilt_max):.1f} deg; largest altitude error {body.altitude_error_max:.2f} m; "
            f"rotors saturated {100 * body.saturated_share:.2g} % of the time; "
            f"{body.energy / 3600:.4g} Wh consumed"
        )
    if flight.log:
        lines.append(f"log: {flight.log}")
    if not flight.complete:
        end = "; the log is complete up to there" if flight.log else ""
        lines.append(f"interrupted at {flight.flown:g} s of {flight.scenario.duration:g} s{end}")
    return lines
