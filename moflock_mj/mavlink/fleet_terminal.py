"""What a fleet looks like in a terminal: its endpoints, a status line, the end."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import math
import socket
import time
from collections.abc import AsyncIterator

from rich.console import Console
from rich.live import Live
from rich.table import Table

from moflock_mj.errors import FleetError
from moflock_mj.mavlink.fleet import Fleet, FleetPlan, FleetState
from moflock_mj.mavlink.link import Address
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.terminal import stop_on_interrupt

_REFRESH = 0.5
"""s, between two status lines."""


def address(text: str) -> Address:
    """Numeric host and port of a text such as 127.0.0.1:14540.

    Raises:
        FleetError: it is no such text, or nobody knows the host.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise FleetError(f"to: {text!r} must be HOST:PORT with a port from 1 to 65535")
    try:
        return socket.gethostbyname(host), int(port)
    except (OSError, UnicodeError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else "no name of a host"
        raise FleetError(f"to: {host}: {reason}") from None


def run_fleet(plan: FleetPlan, key: SigningKey | None, duration: float | None, *, as_json: bool) -> int:
    """Fly a fleet until its time is over, or Ctrl-C; returns the exit status.

    Raises:
        MoflockError: it cannot be set up.
    """
    seconds = math.inf if duration is None else duration
    if not seconds > 0:
        raise FleetError(f"duration: {seconds:g} s is out of bounds: it must be above 0")
    console = Console(stderr=True)
    preparing = console.status("preparing (a first fleet compiles for some 20 s)")
    with preparing if console.is_terminal else contextlib.nullcontext():
        fleet = Fleet(plan, key)
    began = time.perf_counter()
    asyncio.run(_run(fleet, seconds, signed=key is not None, as_json=as_json))
    state, wall = fleet.state(), time.perf_counter() - began
    if as_json:
        end = dataclasses.asdict(state) | {"real_time_factor": state.time / wall / plan.speed, "wall_seconds": wall}
        print(json.dumps(end), flush=True)
    else:
        console = Console()
        console.print(
            f"{state.time:.1f} s simulated in {wall:.1f} s; {state.received} packets received, "
            f"{state.dropped} dropped, {state.lost} lost on the way, {state.sent} sent",
            highlight=False,
            soft_wrap=True,
        )
    return 0


async def _run(fleet: Fleet, seconds: float, *, signed: bool, as_json: bool) -> None:
    await fleet.open()
    try:
        with stop_on_interrupt() as interrupted:
            if as_json:
                print(json.dumps(_endpoints(fleet, signed)), flush=True)
            else:
                _print_endpoints(fleet, signed)
            async with _status_line(fleet):
                await fleet.run(seconds, interrupted)
    finally:
        fleet.close()


@contextlib.asynccontextmanager
async def _status_line(fleet: Fleet) -> AsyncIterator[None]:
    """A line on stderr that follows the fleet, if that is a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return

    async def follow(live: Live) -> None:
        while True:
            live.update(_status_text(fleet.state(), len(fleet.stations)), refresh=True)
            await asyncio.sleep(_REFRESH)

    with Live(console=console, auto_refresh=False, transient=True) as live:
        task = asyncio.create_task(follow(live))
        try:
            yield
        finally:
            task.cancel()


def _status_text(state: FleetState, vehicles: int) -> str:
    modes = ", ".join(f"{number} {name}" for name, number in sorted(state.modes.items()))
    return (
        f"{state.time:7.1f} s  {state.armed} of {vehicles} armed, {state.flying} flying  {modes}  "
        f"{state.real_time_factor:.2f} of the asked speed  {state.received} in, {state.dropped} dropped"
    )


def _endpoints(fleet: Fleet, signed: bool) -> dict[str, object]:
    return {
        "autopilot": fleet.plan.autopilot,
        "signed": signed,
        "vehicles": [
            {"drone": station.number, "system": station.vehicle.system, "udp": _udp(station.address)}
            for station in fleet.stations
        ],
    }


def _udp(bound: Address | None) -> str:
    return f"{bound[0]}:{bound[1]}" if bound else ""


def _print_endpoints(fleet: Fleet, signed: bool) -> None:
    table = Table("drone", "system id", "UDP", "MAVSDK", "MAVProxy")
    for station in fleet.stations:
        udp = _udp(station.address)
        table.add_row(
            str(station.number), str(station.vehicle.system), udp, f"udpout://{udp}", f"--master udpout:{udp}"
        )
    console = Console()
    console.print(table)
    plan, links = fleet.plan, "signed" if signed else "not signed"
    console.print(
        f"{len(fleet.stations)} {plan.scenario.airframe} as {plan.autopilot}, links {links}; Ctrl-C ends",
        highlight=False,
    )
