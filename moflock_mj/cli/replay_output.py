"""Output of `moflock replay` for a flight that was read, verified or recovered: text, or one JSON object."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

from rich.console import Console

from moflock_mj.analysis.verification import Difference, Verification
from moflock_mj.cli.console import figures_table
from moflock_mj.deployment.setpoint_timing import LatencyFigures
from moflock_mj.log.mcap_records import printable
from moflock_mj.log.reader import LoggedFlight
from moflock_mj.log.recovery import Recovery
from moflock_mj.log.schemas import RESUMED_FROM
from moflock_mj.scenario.scenario import DEPLOYED


def print_logged_flight(flight: LoggedFlight, *, as_json: bool) -> None:
    """Print the results of a logged flight."""
    if as_json:
        print(json.dumps(logged_flight_summary(flight), indent=1))
        return
    console = Console()
    _print_line(console, f"{flight.flock_name}, {flight.flown:g} s, seed {flight.seed}")
    console.print(figures_table(flight))
    for line in _closing_lines(flight):
        _print_line(console, line)


def print_verification(verification: Verification, *, as_json: bool) -> None:
    """Print the result of repeating a logged flight."""
    if as_json:
        print(json.dumps(verification_summary(verification), indent=1))
        return
    console = Console()
    since = f"from {verification.start:g} s " if verification.start else ""
    extent = (
        f"{verification.ticks} samples {since}to {verification.time:g} s, repeated in {verification.wall_seconds:.1f} s"
    )
    if verification.difference is None:
        _print_line(console, f"bit-identical: {extent}")
        if verification.time < verification.duration - 1e-9:
            _print_line(console, f"the log ends at {verification.time:g} s of {verification.duration:g} s")
    else:
        _print_line(console, f"NOT identical: {_where(verification.difference)} ({extent})")
        if not verification.changes:
            _print_line(console, "all versions match the log: the log was edited, or the machine is faulty")
    for change in verification.changes:
        likely = "likely reason: " if verification.difference else ""
        logged = printable(change.logged) or "unknown"
        _print_line(console, f"{likely}{change.name} was {logged} and is {change.here or 'unknown'} here")


def print_recovery(recovery: Recovery, *, as_json: bool) -> None:
    """Print the result of recovering a log."""
    if as_json:
        print(json.dumps(recovery_summary(recovery), indent=1))
        return
    console = Console()
    whole = recovery.duration - recovery.start
    # A deployment's log includes take-off and landing, which the scenario's duration does not.
    share = f" of {whole:g} s" if recovery.kept <= whole + 1e-9 else ""
    _print_line(console, f"kept: {recovery.kept:g} s{share}, {recovery.messages} messages")
    if recovery.lost:
        _print_line(console, f"lost: {recovery.lost:g} s")
    if not recovery.end_known:
        hint = "a program that is killed loses at most its last simulated second"
        _print_line(console, f"breaks off at {recovery.end:g} s; {hint}")
    elif not recovery.lost:
        _print_line(console, "lost: nothing")
    for problem in recovery.problems:
        _print_line(console, f"damage: {problem}")
    _print_line(console, f"log: {recovery.log}")


def logged_flight_summary(flight: LoggedFlight) -> dict[str, Any]:
    """A logged flight's results as JSON values, named as in `moflock_mj.cli.console.flight_summary`."""
    return {
        "dynamics": flight.dynamics,
        "seed": flight.seed,
        "drones": flight.scenario.drones,
        "duration": flight.scenario.duration,
        "start": flight.start,
        "flown": flight.flown,
        "missing": flight.missing,
        "complete": flight.complete,
        "order_parameters": flight.order_parameters._asdict(),
        "fitness": flight.fitness._asdict(),
        "events": len(flight.events),
        "samples": len(flight.samples.t),
        "states": sorted(flight.states),
        "error": flight.result.get("error"),
        "metadata": {name: text for name, text in flight.metadata.items() if name not in ("scenario", "parameters")},
        "log": str(flight.log),
    }


def verification_summary(verification: Verification) -> dict[str, Any]:
    """A verification as JSON values."""
    difference = verification.difference
    return {
        "log": str(verification.log),
        "identical": verification.identical,
        "samples": verification.ticks,
        "start": verification.start,
        "time": verification.time,
        "duration": verification.duration,
        "difference": difference._asdict() if difference else None,
        "changes": [change._asdict() for change in verification.changes],
        "wall_seconds": verification.wall_seconds,
    }


def recovery_summary(recovery: Recovery) -> dict[str, Any]:
    """A recovery as JSON values."""
    return {
        "broken": str(recovery.broken),
        "log": str(recovery.log),
        "start": recovery.start,
        "end": recovery.end,
        "kept": recovery.kept,
        "lost": recovery.lost,
        "end_known": recovery.end_known,
        "duration": recovery.duration,
        "messages": recovery.messages,
        "problems": list(recovery.problems),
    }


def _closing_lines(flight: LoggedFlight) -> list[str]:
    metadata = {name: printable(text) for name, text in flight.metadata.items()}
    lines = [
        f"flown {metadata.get('started', 'at an unknown time')} with moflock {metadata.get('moflock_version', '?')}, "
        f"MuJoCo {metadata.get('mujoco_version', '?')}, on {metadata.get('cpu') or 'an unknown processor'}"
    ]
    levels = Counter(event.level for event in flight.events)
    if levels:
        counts = ", ".join(f"{count} {level}" for level, count in sorted(levels.items()))
        lines.append(f"events: {counts}")
    if flight.dynamics == DEPLOYED:
        lines += _latency_lines(flight.result.get("latency", ""))
    if flight.start:
        lines.append(f"resumed at {flight.start:g} s from {metadata.get(RESUMED_FROM, 'another log')}")
    if flight.missing:
        lines.append(f"recovered; {flight.missing:g} s are missing in between")
    lines.append(f"log: {flight.log}")
    if not flight.complete:
        reason = f": {printable(flight.result['error'])}" if "error" in flight.result else ""
        lines.append(f"ended at {flight.flown:g} s of {flight.scenario.duration:g} s{reason}")
    return lines


def _latency_lines(text: str) -> list[str]:
    """The setpoint timing of a deployment's log, in words; empty if the log has none."""
    try:
        figures = LatencyFigures(**json.loads(text))
        return [figures.sentence()]
    except (ValueError, TypeError):
        return []


def _where(difference: Difference) -> str:
    which = "" if difference.drone is None else f" of drone {difference.drone}"
    return f"{difference.what}{which} at {difference.time:g} s (sample {difference.tick})"


def _print_line(console: Console, line: str) -> None:
    """Print a line without markup, since it can contain text from a file."""
    console.print(line, highlight=False, markup=False, soft_wrap=True)
