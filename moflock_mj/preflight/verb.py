"""`moflock preflight`: everything at once, and what it prints."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import importlib.metadata
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from controllers.flocking import FlockingParams
from moflock_mj.flight import Flight
from moflock_mj.flight_log import source_commit
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.preflight.grades import FLOCK, POINT, Grade, Item
from moflock_mj.preflight.live import Inspection, LivePlan, Told, inspect
from moflock_mj.preflight.offline import offline_items
from moflock_mj.preflight.report import Report, default_path, signer, write_report
from moflock_mj.preflight.trials import fly_trials, trial_items
from moflock_mj.scenario import Scenario
from moflock_mj.terminal import share_progress

_STYLES = {Grade.PASS: "green", Grade.WARNING: "yellow", Grade.OFF: "dim"}


def preflight(
    point_name: str,
    params: FlockingParams,
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
    seen: Inspection | None = None
    if live is not None:
        with _status() as told:
            seen = asyncio.run(inspect(live, key, told))
        scenario = scenario.replace(drones=len(seen.vehicles))
    items = offline_items(params, scenario, link_delay=seen.link_delay if seen else 0.0)
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
        point={name: float(value) for name, value in params._asdict().items()},
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
    console = Console()
    groups: dict[tuple[str, Grade], list[Item]] = {}
    for item in report.items:
        if whole or item.grade is not Grade.PASS:
            groups.setdefault((item.name, item.grade), []).append(item)
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


def _table(groups: Iterable[list[Item]]) -> Table:
    """One row for the same check with the same grade of several vehicles."""
    table = Table("check", "of", "value", "limit", "grade")
    for items in groups:
        grade = items[0].grade
        style = _STYLES.get(grade, "red")
        limits = dict.fromkeys(item.limit for item in items)
        table.add_row(
            items[0].name,
            _who(items),
            _values(items),
            next(iter(limits)) + (" ..." if len(limits) > 1 else ""),
            f"[{style}]{grade}[/{style}]",
        )
    return table


def _who(items: Sequence[Item]) -> str:
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


def _values(items: Sequence[Item]) -> str:
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
    parts: dict[str, list[bool]] = {}
    for item in report.items:
        part = item.about if item.about in (POINT, FLOCK) else "vehicles"
        parts.setdefault(part, []).append(item.grade is Grade.PASS)
    return ", ".join(f"{name} {sum(passed)} of {len(passed)}" for name, passed in parts.items())


def _energy(flights: Sequence[Flight], scenario: Scenario) -> float | None:
    """J that one drone took in the hardest flight."""
    taken = [flight.body.energy / scenario.drones for flight in flights if flight.body]
    return float(np.max(taken)) if taken else None


@contextlib.contextmanager
def _status() -> Iterator[Told]:
    """A line on stderr, if that is a terminal, of what is being done."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda _: None
        return
    with console.status("") as line:
        yield line.update
