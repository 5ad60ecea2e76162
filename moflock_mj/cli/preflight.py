"""The verb that checks before anybody flies: its options, and nothing else."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import importlib.metadata
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from moflock_mj.cli.options import AsJson, Count, Drones, KeyFile, ScenarioFile, given_scenario
from moflock_mj.errors import ReportError

if TYPE_CHECKING:
    from rich.table import Table

    from moflock_mj.mavlink.signing import SigningKey
    from moflock_mj.preflight.inspection import Inspection, LivePlan, StatusCallback
    from moflock_mj.preflight.report import Report
    from moflock_mj.preflight.results import CheckItem, CheckResult
    from moflock_mj.scenario.scenario import Scenario
    from moflock_mj.simulation.results import Flight

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
    from moflock_mj.deployment.watchdogs import Watchdogs
    from moflock_mj.ground_station.origin import parse_origin
    from moflock_mj.mavlink.addresses import parse_vehicles
    from moflock_mj.mavlink.signing import find_key
    from moflock_mj.parameters.points import load_point
    from moflock_mj.preflight.inspection import LivePlan

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
            separation=Watchdogs().separation.limit,
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


_STYLES = {"pass": "green", "warning": "yellow", "off": "dim"}
"""Styles of grades in the terminal; others are red."""


def preflight(
    point_name: str,
    params: NamedTuple,
    scenario: Scenario,
    *,
    live: LivePlan | None,
    key: SigningKey | None,
    seeds: Sequence[int],
    signed_off_by: str | None,
    out: Path | None,
    whole: bool,
    as_json: bool,
) -> int:
    """Check, write the report, print it; returns the exit status.

    Args:
        point_name: what the point is called.
        params: the point.
        scenario: to be flown; with vehicles, its drones are as many as they are.
        live: the vehicles, or None.
        key: of the links, and of the report's seal.
        seeds: of the flights on rigid bodies.
        signed_off_by: who answers for the report; the user, if None.
        out: the report; a new file in logs/ if None.
        whole: print what passed, too.
        as_json: print the report instead of a table.

    Raises:
        MoflockError: something cannot be checked at all, or the report cannot be written.
    """
    from controllers.policies.registry import spec_of, values_of
    from moflock_mj.cli.console import share_progress
    from moflock_mj.log.flight_logger import source_commit
    from moflock_mj.preflight.inspection import inspect
    from moflock_mj.preflight.parameter_checks import parameter_items
    from moflock_mj.preflight.report import Report, default_path, signer, write_report
    from moflock_mj.preflight.simulation_checks import fly_trials, trial_items

    seen: Inspection | None = None
    if live is not None:
        with _status() as told:
            seen = asyncio.run(inspect(live, key, told))
        scenario = scenario.replace(drones=len(seen.vehicles))
    items = parameter_items(params, scenario, link_delay=seen.link_delay if seen else 0.0)
    energy = None
    if seeds:
        with share_progress(f"{len(seeds)} flights on rigid bodies") as flown:
            flights = fly_trials(params, scenario, seeds, progress=flown)
        items += trial_items(flights, scenario)
        energy = _energy(flights, scenario)
    if seen is not None:
        items += [*seen.items, *seen.batteries(energy)]
    now = datetime.datetime.now(datetime.UTC)
    report = Report(
        time=now,
        signed_off_by=signed_off_by or signer(),
        version=importlib.metadata.version("moflock-mj"),
        commit=source_commit(),
        policy=spec_of(params).name,
        point=values_of(params),
        point_name=point_name,
        scenario=json.loads(json.dumps(scenario.to_dict())),
        seeds=tuple(seeds),
        vehicles=seen.vehicles if seen else (),
        items=tuple(items),
        changes=seen.changes if seen else (),
    )
    path = out or default_path(Path("logs"), Path(point_name).stem, now)
    write_report(report, path, key)
    if as_json:
        print(json.dumps(report.model_dump(mode="json") | {"verdict": report.verdict, "report": str(path)}, indent=1))
    else:
        print_report(report, path, whole=whole)
    return 0 if report.verdict.is_good else 1


def print_report(report: Report, path: Path, *, whole: bool) -> None:
    """Print a report: a table of what is not well, or of everything, what to do, and the verdict."""
    from rich.console import Console

    from moflock_mj.preflight.results import CheckResult

    console = Console()
    groups: dict[tuple[str, CheckResult], list[CheckItem]] = {}
    for item in report.items:
        if whole or item.result is not CheckResult.PASS:
            groups.setdefault((item.name, item.result), []).append(item)
    if groups:
        console.print(_table(groups.values()))
    for (name, _), items in groups.items():
        for advice in dict.fromkeys(item.advice for item in items if item.advice):
            console.print(f"{name}: {advice}", highlight=False, soft_wrap=True)
    for change in report.changes:
        console.print(f"changed: {change}", highlight=False, soft_wrap=True)
    console.print(f"passed: {_counts(report)}", highlight=False)
    what = f"{len(report.vehicles)} vehicles" if report.vehicles else "no vehicles"
    console.print(
        f"{report.point_name}, {what}: [bold]{report.verdict}[/bold]; signed off by {report.signed_off_by}",
        highlight=False,
    )
    console.print(f"report: {path}", highlight=False, soft_wrap=True)


def _table(groups: Iterable[list[CheckItem]]) -> Table:
    """One row for the same check with the same grade of several vehicles."""
    from rich.table import Table

    table = Table("check", "of", "value", "limit", "grade")
    for items in groups:
        result = items[0].result
        style = _STYLES.get(result.value, "red")
        limits = dict.fromkeys(item.limit for item in items)
        table.add_row(
            items[0].name,
            _who(items),
            _values(items),
            next(iter(limits)) + (" ..." if len(limits) > 1 else ""),
            f"[{style}]{result}[/{style}]",
        )
    return table


def _who(items: Sequence[CheckItem]) -> str:
    """The point, the flock, or vehicles, with ranges: "vehicles 1-3, 7"."""
    numbers = sorted(int(item.about.split()[1]) for item in items if " " in item.about)
    if not numbers:
        return items[0].about
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    told = ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)
    return f"vehicle{'s' * (len(numbers) > 1)} {told}"


def _values(items: Sequence[CheckItem]) -> str:
    """The value, or the least and the largest."""
    values, unit = [item.value for item in items], items[0].unit
    numbers = sorted(value for value in values if isinstance(value, float))
    if numbers:
        ends = dict.fromkeys(f"{value:.4g}" for value in (numbers[0], numbers[-1]))
        return f"{' to '.join(ends)} {unit}".rstrip()
    texts = dict.fromkeys(value for value in values if isinstance(value, str))
    return next(iter(texts), "") + (" ..." if len(texts) > 1 else "")


def _counts(report: Report) -> str:
    """How many items passed, of the point, the flock and the vehicles."""
    from moflock_mj.preflight.results import FLOCK, POINT, CheckResult

    parts: dict[str, list[bool]] = {}
    for item in report.items:
        part = item.about if item.about in (POINT, FLOCK) else "vehicles"
        parts.setdefault(part, []).append(item.result is CheckResult.PASS)
    return ", ".join(f"{name} {sum(passed)} of {len(passed)}" for name, passed in parts.items())


def _energy(flights: Sequence[Flight], scenario: Scenario) -> float | None:
    """J that one drone took in the hardest flight."""
    import numpy as np

    taken = [flight.body.energy / scenario.drones for flight in flights if flight.body]
    return float(np.max(taken)) if taken else None


@contextlib.contextmanager
def _status() -> Iterator[StatusCallback]:
    """A line on stderr, if that is a terminal, of what is being done."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda _: None
        return
    with console.status("") as line:
        yield line.update
