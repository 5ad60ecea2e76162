"""Terminal output of `moflock fleet --physics-for`: ports, status line, and summary of the real autopilots."""

from __future__ import annotations

import contextlib
import json
import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.table import Table

from moflock_mj.cli.console import stop_on_interrupt
from moflock_mj.errors import FleetError
from moflock_mj.sitl.interface import HOST
from moflock_mj.sitl.lockstep import LockStep, PhysicsPlan
from moflock_mj.sitl.processes import PLACEHOLDERS, Processes, fill_command

_REFRESH = 0.5
"""Interval of the status line, s."""


def run_physics(
    plan: PhysicsPlan, command: str | None, folder: Path | None, duration: float | None, *, as_json: bool
) -> int:
    """Simulate the physics of real autopilots for a duration or until Ctrl-C; returns the exit status.

    Args:
        plan: plan of the simulation.
        command: command that starts one autopilot, see `moflock_mj.sitl.processes`; None if the user starts them.
        folder: folder of the autopilots' working directories; None for a new one in logs/.
        duration: simulated time from when all autopilots are connected, s; None for until Ctrl-C.
        as_json: whether to print JSON objects.

    Raises:
        MoflockError: the simulation cannot be set up, or an autopilot ends before it connects.
    """
    seconds = math.inf if duration is None else duration
    if not seconds > 0:
        raise FleetError(f"duration: {seconds:g} s is out of bounds: it must be above 0")
    if command is not None:
        fill_command(command, dict.fromkeys(PLACEHOLDERS, 0))
    console = Console(stderr=True)
    with contextlib.ExitStack() as stack:
        programs: list[Processes] = []
        preparing = console.status("preparing (the first run compiles for about 20 s)")
        with preparing if console.is_terminal else contextlib.nullcontext():
            world = LockStep(
                plan,
                notice=lambda line: console.print(line, highlight=False, soft_wrap=True),
                ended=lambda number: programs[0].ended(number) if programs else None,
            )
        world.open()
        stack.callback(world.close)
        interrupted = stack.enter_context(stop_on_interrupt())
        if command is not None:
            commands = [fill_command(command, values) for values in _values(world)]
            programs.append(stack.enter_context(Processes(commands, folder or _new_folder(plan))))
        _print_start(world, programs[0].folder if programs else None, as_json=as_json)
        began = time.perf_counter()
        if world.gather(interrupted):
            console.print(f"{_autopilots(world)} connected", highlight=False)
            began = time.perf_counter()
            with _status_line(world, console):
                world.run(seconds, interrupted)
        _print_end(world, time.perf_counter() - began, as_json=as_json)
    return 0


def _values(world: LockStep) -> Iterator[dict[str, object]]:
    """Values of the command's placeholders for each vehicle."""
    plan, origin = world.plan, world.plan.origin
    for link in world.links:
        yield {
            "instance": link.number,
            "sysid": link.number + 1,
            "port": link.port,
            # Airframes start with their x axis along the world's x axis, which is east: heading 90.
            "home": f"{origin.latitude:.7f},{origin.longitude:.7f},{origin.altitude:g},90",
            "speed": f"{plan.speed:g}",
            "here": Path.cwd(),
        }


def _new_folder(plan: PhysicsPlan) -> Path:
    return Path("logs") / f"{time.strftime('%Y%m%d-%H%M%S')}-{plan.autopilot}"


def _autopilots(world: LockStep) -> str:
    number = len(world.links)
    return f"{number} {world.plan.autopilot} autopilot{'s' * (number > 1)}"


def _print_start(world: LockStep, folder: Path | None, *, as_json: bool) -> None:
    ports = [link.port for link in world.links]
    if as_json:
        start = {
            "physics_for": world.plan.autopilot,
            "host": HOST,
            "ports": ports,
            "folder": str(folder) if folder else None,
        }
        print(json.dumps(start), flush=True)
        return
    table = Table("drone", "system id", "physics at", "autopilot's output")
    for link in world.links:
        output = f"{folder}/{link.number}/output.txt" if folder else "start it yourself"
        table.add_row(str(link.number), str(link.number + 1), f"{HOST}:{link.port}", output)
    console = Console()
    console.print(table)
    console.print(f"{_autopilots(world)} on {world.plan.scenario.airframe} airframes; Ctrl-C ends", highlight=False)


def _print_end(world: LockStep, wall: float, *, as_json: bool) -> None:
    counts = [link.counts for link in world.links]
    end = {
        "time": world.time,
        "wall_seconds": wall,
        "real_time_factor": world.time / max(wall, 1e-9) / world.plan.speed,
        "present": sum(link.present for link in world.links),
        "received": sum(count.received for count in counts),
        "dropped": sum(count.dropped for count in counts),
        "restarts": sum(count.restarts for count in counts),
    }
    if as_json:
        print(json.dumps(end), flush=True)
        return
    Console().print(
        f"{world.time:.1f} s simulated in {wall:.1f} s; {end['received']} outputs received, {end['dropped']} packets "
        f"dropped, {end['restarts']} restarts",
        highlight=False,
        soft_wrap=True,
    )


@contextlib.contextmanager
def _status_line(world: LockStep, console: Console) -> Iterator[None]:
    """Show the simulation's state in one line on stderr, if that is a terminal."""
    if not console.is_terminal:
        yield
        return
    done = threading.Event()
    with Live(console=console, auto_refresh=False, transient=True) as live:

        def follow() -> None:
            while not done.wait(_REFRESH):
                live.update(_status_text(world), refresh=True)

        thread = threading.Thread(target=follow, name="status", daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()


def _status_text(world: LockStep) -> str:
    heights = world.bodies.qpos[:, 2] - world.bodies.ground
    present = sum(link.present for link in world.links)
    return (
        f"{world.time:7.1f} s  {present} of {len(world.links)} connected, {int((heights > 0.2).sum())} in the air, "
        f"highest {heights.max():.1f} m  {world.real_time_factor():.2f} of the requested speed"
    )
