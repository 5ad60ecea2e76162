"""The command `moflock fleet`: its options, and the terminal output of simulated vehicles."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import math
import socket
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moflock_mj.cli.options import (
    Airframe,
    Autopilot,
    KeyFile,
    given_scenario,
    refuse_options,
)
from moflock_mj.errors import FleetError

if TYPE_CHECKING:
    from rich.live import Live

    from moflock_mj.mavlink.endpoint import Address
    from moflock_mj.mavlink.signing import SigningKey
    from moflock_mj.simulated_vehicles.fleet import Fleet, FleetPlan, FleetState

commands = typer.Typer()


_FLEET_EXAMPLE = """Example: moflock fleet --vehicles 3 --fault vehicle=1,at=60,kind=gps_loss,duration=10

Vehicle i listens on UDP port base-port + i and replies to every sender. MAVSDK: udpout://127.0.0.1:14600 for the first
vehicle. MAVProxy: mavproxy.py --master udpout:127.0.0.1:14600. With --to 127.0.0.1:14540 all vehicles send first, to a
client that listens: MAVSDK udpin://127.0.0.1:14540, MAVProxy --master udpin:127.0.0.1:14540.

A fault has a kind, vehicle (number from 0, or all), at (start, s) and duration (s). Kinds: gps_loss, link_loss
(packets, share lost), link_delay (delay, s), cannot_receive, cannot_transmit, rotor_failure (rotor, 0 to 3),
low_battery (charge, share left), duplicate_id (system), pilot.

With --physics-for, real autopilots fly the simulated airframes. --autopilot-command starts these programs; without it,
start them yourself. They connect to 127.0.0.1: ArduPilot's instance i to UDP port 9002 + 10 i, PX4's to TCP port
4560 + i:

  moflock fleet --physics-for ardupilot --vehicles 3 --autopilot-command "arducopter --model JSON:127.0.0.1
-I{instance} --sysid {sysid} --home {home} --speedup {speed} --defaults {here}/copter.parm"

  moflock fleet --physics-for px4 --autopilot-command "env PX4_SYS_AUTOSTART=10016 px4 -i {instance} -d /px4/etc"

Links are signed if --key-file or the environment variable MOFLOCK_SIGNING_KEY provides a key: 64 hexadecimal digits, or
a pass phrase."""


@commands.command("fleet", epilog=_FLEET_EXAMPLE)
def fleet_command(
    context: typer.Context,
    vehicles: Annotated[
        int | None, typer.Option(help="Number of vehicles; by default the drones of --scenario, or 1.")
    ] = None,
    autopilot: Annotated[Autopilot, typer.Option(help="Autopilot to simulate.")] = Autopilot.ARDUPILOT,
    base_port: Annotated[int, typer.Option(help="UDP port of the first vehicle; 0 for any free ports.")] = 14600,
    bind: Annotated[str, typer.Option(help="Local address on which the vehicles listen.")] = "127.0.0.1",
    to: Annotated[str | None, typer.Option(help="HOST:PORT of a client to which the vehicles send first.")] = None,
    speed: Annotated[float, typer.Option(help="Simulated seconds per real second.")] = 1.0,
    spacing: Annotated[float, typer.Option(help="Distance between neighbours on the ground, m.")] = 12.0,
    boot: Annotated[float, typer.Option(help="Simulated time from power-on to a usable position, s.")] = 8.0,
    scenario: Annotated[Path | None, typer.Option(help="TOML file of the scenario: airframe, response, noise.")] = None,
    airframe: Airframe = None,
    fault: Annotated[
        list[str] | None, typer.Option(help="Fault to inject, as below; may be given several times.")
    ] = None,
    faults: Annotated[Path | None, typer.Option(help="TOML file of faults, one table [[faults]] each.")] = None,
    key_file: KeyFile = None,
    physics_for: Annotated[Autopilot | None, typer.Option(help="Simulate the physics for real autopilots.")] = None,
    autopilot_command: Annotated[
        str | None,
        typer.Option(
            help="Command that starts one real autopilot, with placeholders {instance}, {sysid}, {port}, {home}, "
            "{speed}, {here}."
        ),
    ] = None,
    autopilot_folder: Annotated[
        Path | None,
        typer.Option(help="Folder of the real autopilots' working directories; by default a new one in logs/."),
    ] = None,
    physics_port: Annotated[
        int | None, typer.Option(help="Physics port of the first vehicle; the autopilot's default if absent.")
    ] = None,
    duration: Annotated[float | None, typer.Option(help="Simulated time, s; by default until Ctrl-C.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.")] = 1,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print a JSON object at the start and one at the end.")
    ] = False,
) -> int:
    """Simulate MAVLink vehicles in real time to rehearse deployments."""
    from moflock_mj.mavlink.signing import find_key
    from moflock_mj.simulated_vehicles.fleet import FleetPlan
    from moflock_mj.simulated_vehicles.vehicle_faults import VehicleFault, load_faults

    flown = given_scenario(scenario, airframe=airframe)
    number = vehicles if vehicles is not None else flown.drones if scenario else 1
    if physics_for is not None:
        refuse_options(context, _SIMULATED_AUTOPILOT_OPTIONS, "--physics-for")
        from moflock_mj.cli.sitl import run_physics
        from moflock_mj.sitl.lockstep import PhysicsPlan

        physics = PhysicsPlan(
            autopilot=physics_for.value,
            vehicles=number,
            port=physics_port,
            speed=speed,
            spacing=spacing,
            scenario=flown,
            seed=seed,
        )
        return run_physics(physics, autopilot_command, autopilot_folder, duration, as_json=as_json)
    refuse_options(context, ("autopilot_command", "autopilot_folder", "physics_port"), "simulated autopilots")
    plan = FleetPlan(
        vehicles=number,
        autopilot=autopilot.value,
        base_port=base_port,
        bind=bind,
        to=address(to) if to else None,
        speed=speed,
        spacing=spacing,
        boot=boot,
        scenario=flown,
        faults=[*(load_faults(faults) if faults else ()), *map(VehicleFault.from_text, fault or ())],
        seed=seed,
    )
    return run_fleet(plan, find_key(key_file), duration, as_json=as_json)


_REFRESH = 0.5
"""Interval of the status line, s."""


def address(text: str) -> Address:
    """Parse a text such as 127.0.0.1:14540 into numeric host and port.

    Raises:
        FleetError: the text has another form, or the host cannot be resolved.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise FleetError(f"to: {text!r}: it must be HOST:PORT with a port from 1 to 65535")
    try:
        return socket.gethostbyname(host), int(port)
    except (OSError, UnicodeError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else "not a host name"
        raise FleetError(f"to: {host}: {reason}") from None


def run_fleet(plan: FleetPlan, key: SigningKey | None, duration: float | None, *, as_json: bool) -> int:
    """Simulate a fleet for a duration or until Ctrl-C; returns the exit status.

    Raises:
        MoflockError: the fleet cannot be set up.
    """
    from rich.console import Console

    from moflock_mj.simulated_vehicles.fleet import Fleet

    seconds = math.inf if duration is None else duration
    if not seconds > 0:
        raise FleetError(f"duration: {seconds:g} s is out of bounds: it must be above 0")
    console = Console(stderr=True)
    preparing = console.status("preparing (the first fleet compiles for about 20 s)")
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
            f"{state.dropped} dropped, {state.lost} lost in transit, {state.sent} sent",
            highlight=False,
            soft_wrap=True,
        )
    return 0


async def _run(fleet: Fleet, seconds: float, *, signed: bool, as_json: bool) -> None:
    from moflock_mj.cli.console import stop_on_interrupt

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
    """Show the fleet's state in one line on stderr, if that is a terminal."""
    from rich.console import Console
    from rich.live import Live

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
        f"{state.real_time_factor:.2f} of the requested speed  {state.received} in, {state.dropped} dropped"
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
    from rich.console import Console
    from rich.table import Table

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


_SIMULATED_AUTOPILOT_OPTIONS = ("autopilot", "base_port", "bind", "to", "boot", "fault", "faults", "key_file")
"""Options that apply to simulated autopilots only."""
