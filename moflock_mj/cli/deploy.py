"""The command `moflock deploy`: its options, its terminal output, and the handling of Ctrl-C."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import enum
import json
import signal
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moflock_mj.cli.options import (
    AsJson,
    Autopilot,
    Count,
    KeyFile,
    PointArgument,
    ScenarioFile,
    given_scenario,
)
from moflock_mj.errors import CheckFailedError, DeploymentError

if TYPE_CHECKING:
    from rich.console import Console

    from moflock_mj.deployment.deployment import Check, Deployed, DeployPlan, InterruptHandler
    from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
    from moflock_mj.ground_station.station import GroundStation
    from moflock_mj.mavlink.signing import SigningKey
    from moflock_mj.metrics.events import FlightEvent
    from moflock_mj.scenario.scenario import Scenario

commands = typer.Typer()


class FinishOption(enum.StrEnum):
    """End of a deployment."""

    HOLD = "hold"
    RETURN = "return"
    LAND = "land"


_DEPLOY_EXAMPLE = """Example: moflock deploy steady --vehicles udp:127.0.0.1:14600-14609 --duration 60 --rehearse

Vehicles are KIND:HOST:PORT or KIND:HOST:PORT-LAST, several separated by commas. udp (or udpout) sends first, to
vehicles that listen, such as those of moflock fleet. udpin listens; PX4 sends to port 14540 + i, ArduPilot to 14550.
tcp connects; ArduPilot's simulators listen at 5760, 5770, ...

Ctrl-C (or SIGTERM) once: all vehicles hold. Twice: all land. Three times: control is released, and the vehicles' own
failsafes take over.

Watchdogs are NAME=LIMIT:ACTION, such as battery=0.3:return. Actions: slow, hold, return, land. Names: stale (age of the
position, s), lost (silence, s), fence (stopping point outside the arena, m), separation (distance to the nearest
vehicle, m), battery (share of charge). keep_off (distance kept from a vehicle that left the flock, m) has no action. A
vehicle in a mode that deploy did not request is under a pilot or a failsafe, and is not commanded again."""


@commands.command("deploy", epilog=_DEPLOY_EXAMPLE)
def deploy_command(
    point: PointArgument,
    vehicles: Annotated[str, typer.Option(help="Addresses of the vehicles, such as udp:127.0.0.1:14600-14609.")],
    scenario: ScenarioFile = None,
    duration: Annotated[
        float | None, typer.Option(help="Time under the policy, s; by default the scenario's duration.")
    ] = None,
    count: Count = None,
    autopilot: Annotated[
        Autopilot | None, typer.Option(help="Autopilot that all vehicles must have; by default any.")
    ] = None,
    finish: Annotated[FinishOption, typer.Option(help="Action at the end.")] = FinishOption.LAND,
    origin: Annotated[
        str | None,
        typer.Option(help="LATITUDE,LONGITUDE of the arena's centre, degrees; by default the mean of the homes."),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Report of moflock preflight; by default the newest matching one in logs/.")
    ] = None,
    rehearse: Annotated[
        bool,
        typer.Option("--rehearse", help="Skip the pre-flight report; accepted for simulated vehicles only."),
    ] = False,
    watchdog: Annotated[list[str] | None, typer.Option(help="NAME=LIMIT:ACTION; may be given several times.")] = None,
    interval: Annotated[float, typer.Option(help="Time between two take-offs, s.", min=0.0, max=60.0)] = 1.0,
    timeout: Annotated[float, typer.Option(help="Time to wait for the vehicles, s.", min=0.0, max=600.0)] = 10.0,
    key_file: KeyFile = None,
    log: Annotated[str | None, typer.Option(help="MCAP file, or none; by default a new file in logs/.")] = None,
    as_json: AsJson = False,
) -> int:
    """Fly real or simulated vehicles with a checked point.

    Unless --rehearse is given, a recent report of preflight must cover the point, the scenario and the vehicles.
    """
    return deploy_vehicles(
        point,
        vehicles,
        given_scenario(scenario, duration=duration),
        count=count,
        autopilot=autopilot.value if autopilot else None,
        finish=finish.value,
        origin=origin,
        report=report,
        rehearse=rehearse,
        watchdogs=watchdog or (),
        interval=interval,
        timeout=timeout,
        key_file=key_file,
        log=log,
        as_json=as_json,
    )


FAILED = 1
"""Exit status after a failed check or a failed flight."""


_SWITCH_INTERVAL = 0.0005
"""Thread switch interval, s."""


def run_deployment(plan: DeployPlan, key: SigningKey | None, check: Check | None, *, as_json: bool) -> int:
    """Deploy a flock; returns the exit status.

    Raises:
        MoflockError: the deployment was refused before any vehicle was armed.
    """
    from rich.console import Console

    from moflock_mj.cli.options import INTERRUPTED

    console = Console(highlight=False, soft_wrap=True)

    def say(event: FlightEvent) -> None:
        if not as_json:
            console.print(f"{event.time_ns / 1e9:7.1f} s  {_mark(event)}{event.message}", markup=False)

    # The log's thread must not delay a setpoint.
    sys.setswitchinterval(_SWITCH_INTERVAL)
    try:
        deployed = asyncio.run(_deploy(plan, key, check, say))
    except CheckFailedError as problem:
        print("moflock:", problem, file=sys.stderr)
        return FAILED
    except asyncio.CancelledError:
        return INTERRUPTED
    if as_json:
        print(json.dumps(deployment_summary(deployed), indent=1))
    else:
        _print_deployment(console, deployed)
    if deployed.interrupted:
        return INTERRUPTED
    return FAILED if deployed.error else 0


def deployment_summary(deployed: Deployed) -> dict[str, Any]:
    """A deployment's results as JSON values, with the names of a simulated flight where both have them."""
    figures, plan = deployed.figures, deployed.plan
    return {
        "dynamics": "deployed",
        "drones": plan.scenario.drones,
        "duration": plan.scenario.duration,
        "flown": figures.flocked,
        "complete": deployed.error is None and not deployed.interrupted,
        "interrupted": deployed.interrupted,
        "error": deployed.error,
        "order_parameters": figures.order_parameters._asdict(),
        "fitness": figures.fitness._asdict(),
        "separation_min": figures.separation_min if plan.scenario.drones > 1 else None,
        "outside_max": figures.outside_max,
        "latency": figures.latency._asdict() if figures.latency else None,
        "stages": [stage.value for stage in deployed.stages],
        "origin": dataclasses.asdict(deployed.origin),
        "packets": deployed.counts,
        "events": [
            {"time": event.time_ns / 1e9, "level": event.level, "drone": event.drone, "message": event.message}
            for event in deployed.events
        ],
        "log": str(plan.log) if plan.log else None,
    }


async def _deploy(plan: DeployPlan, key: SigningKey | None, check: Check | None, say: Any) -> Deployed:
    from moflock_mj.deployment.deployment import InterruptHandler, deploy

    whole = asyncio.current_task()
    assert whole is not None
    interrupts = InterruptHandler(whole.cancel)
    with _interrupts_by_signal(interrupts):
        return await deploy(plan, key, interrupts, check=check, say=say)


@contextlib.contextmanager
def _interrupts_by_signal(interrupts: InterruptHandler) -> Iterator[None]:
    """Pass Ctrl-C and SIGTERM to the interrupt handler."""
    loop = asyncio.get_running_loop()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        loop.add_signal_handler(number, interrupts.press)
    try:
        yield
    finally:
        for number, handler in before.items():
            loop.remove_signal_handler(number)
            signal.signal(number, handler)


def _print_deployment(console: Console, deployed: Deployed) -> None:
    from moflock_mj.cli.console import figures_table
    from moflock_mj.deployment.member import Stage

    figures, plan = deployed.figures, deployed.plan
    console.print(f"{plan.scenario.drones} vehicles, {figures.flocked:.1f} s in the flock")
    console.print(figures_table(figures))
    if plan.scenario.drones > 1 and figures.flocked:
        console.print(f"smallest distance {figures.separation_min:.1f} m; farthest outside {figures.outside_max:.1f} m")
    if figures.latency:
        console.print(figures.latency.sentence())
    counts = deployed.counts
    dropped = counts["malformed"] + counts["unsigned"] + counts["foreign"]
    console.print(f"{counts['received']} packets received, {counts['lost']} lost, {dropped} dropped")
    stages = Counter(deployed.stages)
    if set(stages) != {Stage.DOWN}:
        console.print("at the end: " + ", ".join(f"{count} {stage}" for stage, count in stages.items()))
    if plan.log:
        console.print(f"log: {plan.log}")
    if deployed.error:
        console.print(f"deployment failed: {deployed.error}", markup=False)


def _mark(event: FlightEvent) -> str:
    return "" if event.level == "info" else f"{event.level}: "


def deploy_vehicles(
    point: str,
    vehicles: str,
    scenario: Scenario,
    *,
    count: int | None,
    autopilot: str | None,
    finish: str,
    origin: str | None,
    report: Path | None,
    rehearse: bool,
    watchdogs: Sequence[str],
    interval: float,
    timeout: float,
    key_file: Path | None,
    log: str | None,
    as_json: bool,
) -> int:
    """Deploy with the arguments of the command line; returns the exit status.

    Raises:
        MoflockError: the deployment was refused before any vehicle was armed.
    """
    from moflock_mj.cli.console import log_path
    from moflock_mj.deployment.deployment import DeployPlan, Finish
    from moflock_mj.deployment.watchdogs import Watchdogs
    from moflock_mj.ground_station.origin import parse_origin
    from moflock_mj.mavlink.addresses import parse_vehicles
    from moflock_mj.mavlink.signing import find_key
    from moflock_mj.parameters.points import load_point
    from moflock_mj.scenario.scenario import DEPLOYED

    if rehearse and report is not None:
        raise DeploymentError("report: --rehearse and --report exclude each other; it must be one")
    if scenario.faults:
        raise DeploymentError(
            "faults: the scenario of a deployment must have none; moflock fleet injects faults into simulated vehicles"
        )
    key = find_key(key_file)
    plan = DeployPlan(
        params=load_point(point),
        scenario=scenario,
        connections=parse_vehicles(vehicles),
        count=count,
        autopilot=autopilot,
        finish=Finish(finish),
        origin=parse_origin(origin) if origin else None,
        watchdogs=Watchdogs.from_texts(watchdogs),
        rehearse=rehearse,
        interval=interval,
        timeout=timeout,
        log=log_path(log, point, DEPLOYED, 0),
        metadata={"point": point, "finish": finish, "rehearsal": json.dumps(rehearse)},
    )
    check = None if rehearse else _report_check(plan, report, key)
    return run_deployment(plan, key, check, as_json=as_json)


def _report_check(plan: DeployPlan, path: Path | None, key: SigningKey | None) -> Check:
    """Check that raises unless a report covers the vehicles; raises at once if there is no readable report."""
    from moflock_mj.deployment.clearance import candidates, require_permission

    reports = candidates(path, key)

    async def check(vehicles: list[RemoteVehicle], _: GroundStation) -> None:
        scenario = plan.scenario.replace(drones=len(vehicles))
        require_permission(reports, plan.params, scenario, vehicles)

    return check
