"""The verb that checks before anybody flies: its options, and nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from moflock_mj.errors import ReportError
from moflock_mj.options import AsJson, Count, Drones, KeyFile, ScenarioFile, given_scenario

commands = typer.Typer()

_FLIGHTS = 10

_EXAMPLE = """Example: moflock preflight steady --scenario field.toml --vehicles udp:127.0.0.1:14600-14609 --fix

Without --vehicles: bounds, ranges, braking and loops of the point, and flights on rigid bodies in the scenario to be
flown. With --vehicles, too: links, arming checks, sensors, GPS, estimators, homes, batteries, parameters and fences of
each vehicle, and the flock as a whole. Nothing is changed on a vehicle unless --fix is given, which sets parameters,
uploads the fence, reads all back and lists what it changed.

Vehicles: udp:HOST:PORT or udp:HOST:FIRST-LAST for those that listen, udpin:HOST:PORT to wait for them, tcp:HOST:PORT;
several separated by commas. Links are signed if --key-file or MOFLOCK_SIGNING_KEY gives a key, and so is the report.

Exit status: 0 if all passed, warnings included; 1 if anything failed."""


@commands.command("preflight", epilog=_EXAMPLE)
def preflight_command(
    point: Annotated[str, typer.Argument(help="Named point or .json file.")],
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Annotated[float | None, typer.Option(help="Simulated seconds of each flight.")] = None,
    flights: Annotated[int, typer.Option(help="Flights on rigid bodies.", min=0, max=1000)] = _FLIGHTS,
    seed: Annotated[int, typer.Option(help="Of the first flight.", min=0)] = 1,
    vehicles: Annotated[str | None, typer.Option(help="Where they are, as below.")] = None,
    count: Count = None,
    autopilot: Annotated[str | None, typer.Option(help="What all must be: ardupilot or px4.")] = None,
    origin: Annotated[
        str | None, typer.Option(help="LAT,LON of the arena's middle; by default the homes' mean.")
    ] = None,
    fix: Annotated[bool, typer.Option("--fix", help="Put parameters and fences right.")] = False,
    wait: Annotated[float, typer.Option(help="Seconds for estimators to become ready.", min=0, max=3600)] = 60.0,
    timeout: Annotated[float, typer.Option(help="Seconds for vehicles to be heard.", min=0.1, max=600)] = 10.0,
    key_file: KeyFile = None,
    signed_off_by: Annotated[str | None, typer.Option(help="Who answers for it; by default the user.")] = None,
    out: Annotated[Path | None, typer.Option(help="Report; a new file in logs/ if absent.")] = None,
    everything: Annotated[bool, typer.Option("--all", help="Print what passed, too.")] = False,
    as_json: AsJson = False,
) -> int:
    """Check a point, and the vehicles that are to fly it; a deployment asks for the report."""
    from moflock_mj.deploy.readiness import parse_origin  # noqa: PLC0415 - the command's help does without
    from moflock_mj.mavlink.connections import parse_vehicles  # noqa: PLC0415
    from moflock_mj.mavlink.signing import find_key  # noqa: PLC0415
    from moflock_mj.points import load_point  # noqa: PLC0415
    from moflock_mj.preflight.live import LivePlan  # noqa: PLC0415
    from moflock_mj.preflight.verb import preflight  # noqa: PLC0415

    if autopilot not in (None, "ardupilot", "px4"):
        raise ReportError(f"autopilot: {autopilot!r} is unknown: it must be ardupilot or px4")
    if fix and vehicles is None:
        raise ReportError("fix: there is nothing to put right without --vehicles")
    if flights == 0 and vehicles is not None:
        raise ReportError("flights: 0 is out of bounds: with --vehicles it must be at least 1")
    params = load_point(point)
    flown = given_scenario(scenario, drones=drones, duration=duration)
    live = None
    if vehicles is not None:
        live = LivePlan(
            scenario=flown,
            connections=parse_vehicles(vehicles),
            count=count,
            origin=parse_origin(origin) if origin else None,
            autopilot=autopilot,
            fix=fix,
            wait=wait,
            timeout=timeout,
        )
    return preflight(
        point,
        params,
        flown,
        live=live,
        key=find_key(key_file),
        seeds=range(seed, seed + flights),
        signed_off_by=signed_off_by,
        out=out,
        whole=everything,
        as_json=as_json,
    )
