"""The command `moflock preflight`: its options, its terminal output, and the report that it writes."""

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

from moflock_mj.cli.options import AsJson, Count, Drones, KeyFile, PointArgument, ScenarioFile, given_scenario
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

Without --vehicles, preflight checks the point's bounds, ranges, braking and control loops, and flies it on rigid bodies
in the scenario. With --vehicles it also checks links, arming checks, sensors, GPS, estimators, homes, batteries,
parameters and fences of each vehicle, and the flock as a whole. It changes nothing on a vehicle unless --fix is given:
then it sets parameters, uploads the fence, reads everything back, and lists the changes.

Vehicles: udp:HOST:PORT or udp:HOST:FIRST-LAST for vehicles that listen, udpin:HOST:PORT to wait for vehicles,
tcp:HOST:PORT; several separated by commas. Links and report are signed if --key-file or MOFLOCK_SIGNING_KEY provides a
key.

Exit status: 0 if all checks passed, possibly with warnings; 1 if any failed."""


@commands.command("preflight", epilog=_EXAMPLE)
def preflight_command(
    point: PointArgument,
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Annotated[float | None, typer.Option(help="Simulated time of each flight, s.")] = None,
    flights: Annotated[int, typer.Option(help="Number of rigid-body flights.", min=0, max=1000)] = _FLIGHTS,
    seed: Annotated[int, typer.Option(help="Seed of the first flight.", min=0)] = 1,
    vehicles: Annotated[str | None, typer.Option(help="Addresses of the vehicles, as below.")] = None,
    count: Count = None,
    autopilot: Annotated[
        str | None, typer.Option(help="Autopilot that all vehicles must have: ardupilot or px4; by default any.")
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(help="LATITUDE,LONGITUDE of the arena's centre, degrees; by default the mean of the homes."),
    ] = None,
    fix: Annotated[bool, typer.Option("--fix", help="Correct parameters and fences of the vehicles.")] = False,
    wait: Annotated[float, typer.Option(help="Time to wait for the vehicles' estimators, s.", min=0, max=3600)] = 60.0,
    timeout: Annotated[float, typer.Option(help="Time to wait for the vehicles, s.", min=0.1, max=600)] = 10.0,
    key_file: KeyFile = None,
    signed_off_by: Annotated[
        str | None, typer.Option(help="Person responsible for the report; by default the user.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File of the report; by default a new one in logs/.")] = None,
    everything: Annotated[bool, typer.Option("--all", help="Also print the checks that passed.")] = False,
    as_json: AsJson = False,
) -> int:
    """Check a point and the vehicles to fly it.

    Writes the report that deploy requires.
    """
    from moflock_mj.deployment.watchdogs import Watchdogs
    from moflock_mj.ground_station.origin import parse_origin
    from moflock_mj.mavlink.addresses import parse_vehicles
    from moflock_mj.mavlink.signing import find_key
    from moflock_mj.parameters.points import load_point
    from moflock_mj.preflight.inspection import LivePlan

    if autopilot not in (None, "ardupilot", "px4"):
        raise ReportError(f"autopilot: {autopilot!r} is unknown: it must be ardupilot or px4")
    if fix and vehicles is None:
        raise ReportError("fix: it has no effect without --vehicles")
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
"""Terminal styles of results; others are red."""


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
    """Run the checks, write the report and print it; returns the exit status.

    Args:
        point_name: name of the point.
        params: the point.
        scenario: scenario of the deployment; with vehicles, its number of drones becomes theirs.
        live: plan of the vehicle checks; None for no vehicles.
        key: key of the links and of the report's seal, or None.
        seeds: seeds of the rigid-body flights.
        signed_off_by: person responsible for the report; None for the user.
        out: file of the report; None for a new file in logs/.
        whole: whether to print checks that passed.
        as_json: whether to print the report as JSON instead of a table.

    Raises:
        MoflockError: a check cannot be made, or the report cannot be written.
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
        with _status() as report_status:
            seen = asyncio.run(inspect(live, key, report_status))
        scenario = scenario.replace(drones=len(seen.vehicles))
    items = parameter_items(params, scenario, link_delay=seen.link_delay if seen else 0.0)
    energy = None
    if seeds:
        with share_progress(f"{len(seeds)} rigid-body flights") as progress:
            flights = fly_trials(params, scenario, seeds, progress=progress)
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
    """Print a report: a table of the checks that did not pass, or of all, then the advice and the verdict."""
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
    """Table with one row for the same check with the same result on several vehicles."""
    from rich.table import Table

    table = Table("check", "subject", "value", "limit", "result")
    for items in groups:
        result = items[0].result
        style = _STYLES.get(result.value, "red")
        limits = dict.fromkeys(item.limit for item in items)
        table.add_row(
            items[0].name,
            _subject(items),
            _values(items),
            next(iter(limits)) + (" ..." if len(limits) > 1 else ""),
            f"[{style}]{result}[/{style}]",
        )
    return table


def _subject(items: Sequence[CheckItem]) -> str:
    """The point, the flock, or vehicles as ranges such as "vehicles 1-3, 7"."""
    numbers = sorted(int(item.about.split()[1]) for item in items if " " in item.about)
    if not numbers:
        return items[0].about
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    ranges = ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)
    return f"vehicle{'s' * (len(numbers) > 1)} {ranges}"


def _values(items: Sequence[CheckItem]) -> str:
    """The value, or the smallest and the largest value."""
    values, unit = [item.value for item in items], items[0].unit
    numbers = sorted(value for value in values if isinstance(value, float))
    if numbers:
        ends = dict.fromkeys(f"{value:.4g}" for value in (numbers[0], numbers[-1]))
        return f"{' to '.join(ends)} {unit}".rstrip()
    texts = dict.fromkeys(value for value in values if isinstance(value, str))
    return next(iter(texts), "") + (" ..." if len(texts) > 1 else "")


def _counts(report: Report) -> str:
    """Number of passed checks of the point, the flock and the vehicles."""
    from moflock_mj.preflight.results import FLOCK, POINT, CheckResult

    parts: dict[str, list[bool]] = {}
    for item in report.items:
        part = item.about if item.about in (POINT, FLOCK) else "vehicles"
        parts.setdefault(part, []).append(item.result is CheckResult.PASS)
    return ", ".join(f"{name} {sum(passed)} of {len(passed)}" for name, passed in parts.items())


def _energy(flights: Sequence[Flight], scenario: Scenario) -> float | None:
    """Largest mean energy of a drone over the flights, J."""
    import numpy as np

    taken = [flight.body.energy / scenario.drones for flight in flights if flight.body]
    return float(np.max(taken)) if taken else None


@contextlib.contextmanager
def _status() -> Iterator[StatusCallback]:
    """Show the current step in one line on stderr, if that is a terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda _: None
        return
    with console.status("") as line:
        yield line.update
