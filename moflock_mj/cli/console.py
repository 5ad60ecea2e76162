"""What a flight looks like in a terminal: progress, tables, JSON, Ctrl-C."""

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
from moflock_mj.simulation.results import Progress as Told


def log_path(asked: str | None, point: str, dynamics: str, seed: int) -> Path | None:
    """Where a flight's log goes: the file that the user names, nowhere for "none", else a new file of a folder."""
    if asked == "none":
        return None
    folder = Path("logs") if asked is None else Path(asked)
    if asked is not None and not asked.endswith("/") and not folder.is_dir():
        return folder if folder.suffix == ".mcap" else Path(f"{asked}.mcap")
    now = datetime.datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
    name = point if point in point_names() else Path(point).stem
    return folder / f"{now}-{name}-{dynamics}-seed{seed}.mcap"


class _Rate(ProgressColumn):
    """Simulated time over wall time."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.completed / task.elapsed:.0f}x real time" if task.elapsed else "")


@contextlib.contextmanager
def flight_progress(duration: float) -> Iterator[Told]:
    """A progress bar on stderr, if that is a terminal: simulated time, speed over real time, running fitness."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f} s"),
        _Rate(),
        TextColumn("{task.fields[fitness]}"),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("preparing (a first flight compiles for some 20 s)", total=duration, fitness="")

        def told(flown: float, fitness: Fitness) -> None:
            if not bar.tasks[0].completed:
                bar.reset(task, description="flying")
            bar.update(task, completed=flown, fitness=f"F_1 {fitness.F_1:.3f}  F_2 {fitness.F_2:.3f}")

        yield told


@contextlib.contextmanager
def share_progress(what: str) -> Iterator[Callable[[float], None]]:
    """A progress bar on stderr, if that is a terminal, told the share that is done, from 0 to 1."""
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda share: bar.update(task, completed=share)


@contextlib.contextmanager
def stop_on_interrupt() -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C (or SIGTERM) into a wish to stop; a second one breaks off at once."""
    asked = threading.Event()

    def note(signal_number: int, frame: FrameType | None) -> None:  # noqa: ARG001
        if asked.is_set():
            raise KeyboardInterrupt
        asked.set()

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def print_flight(flight: Flight, *, as_json: bool) -> None:
    """Print a flight's figures to stdout."""
    if as_json:
        print(json.dumps(flight_summary(flight), indent=1))
        return
    console = Console()
    console.print(_head_line(flight), highlight=False)
    console.print(figures_table(flight))
    for line in _closing_lines(flight):
        console.print(line, highlight=False, soft_wrap=True)


def flight_summary(flight: Flight) -> dict[str, Any]:
    """A flight's figures as JSON values."""
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


class Judged(Protocol):
    """What has order parameters and fitness."""

    @property
    def order_parameters(self) -> OrderParameters: ...

    @property
    def fitness(self) -> Fitness: ...


def figures_table(flight: Judged) -> Table:
    """A flight's order parameters and fitness."""
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
            f"touched: {body.touched} of {flight.scenario.drones} drones, {body.lost} lost; largest tilt "
            f"{math.degrees(body.tilt_max):.1f} deg; largest altitude error {body.altitude_error_max:.2f} m; "
            f"a rotor at its limit {100 * body.saturated_share:.2g} % of the time; "
            f"{body.energy / 3600:.4g} Wh taken"
        )
    if flight.log:
        lines.append(f"log: {flight.log}")
    if not flight.complete:
        end = "; the log is finished" if flight.log else ""
        lines.append(f"interrupted at {flight.flown:g} s of {flight.scenario.duration:g} s{end}")
    return lines
