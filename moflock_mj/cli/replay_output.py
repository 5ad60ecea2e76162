"""What `moflock replay` says: of a flight that was read, flown again, or recovered; as text or as one JSON object."""

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
    """Print the figures of a flight that was read from its log."""
    if as_json:
        print(json.dumps(logged_flight_summary(flight), indent=1))
        return
    console = Console()
    _say(console, f"{flight.flock_name}, {flight.flown:g} s, seed {flight.seed}")
    console.print(figures_table(flight))
    for line in _closing_lines(flight):
        _say(console, line)


def print_verification(verification: Verification, *, as_json: bool) -> None:
    """Print what came of flying a log's flight again."""
    if as_json:
        print(json.dumps(verification_summary(verification), indent=1))
        return
    console, told = Console(), verification
    since = f"from {told.start:g} s " if told.start else ""
    way = f"{told.ticks} samples {since}to {told.time:g} s, flown again in {told.wall_seconds:.1f} s"
    if told.difference is None:
        _say(console, f"bit-identical: {way}")
        if told.time < told.duration - 1e-9:
            _say(console, f"the log ends at {told.time:g} s of {told.duration:g} s")
    else:
        _say(console, f"NOT identical: {_where(told.difference)} ({way})")
        if not told.changes:
            _say(console, "all versions are those of the log: it has been changed, or the machine is at fault")
    for change in told.changes:
        likely = "likely reason: " if told.difference else ""
        logged = printable(change.logged) or "unknown"
        _say(console, f"{likely}{change.name} was {logged} and is {change.here or 'unknown'} here")


def print_recovery(recovery: Recovery, *, as_json: bool) -> None:
    """Print what was saved of a log."""
    if as_json:
        print(json.dumps(recovery_summary(recovery), indent=1))
        return
    console, told = Console(), recovery
    whole = told.duration - told.start
    # A deployment's log also tells of the way up and down, which is in nobody's scenario.
    of = f" of {whole:g} s" if told.kept <= whole + 1e-9 else ""
    _say(console, f"kept: {told.kept:g} s{of}, {told.messages} messages")
    if told.lost:
        _say(console, f"lost: {told.lost:g} s")
    if not told.end_known:
        hint = "a program that is killed loses at most its last simulated second"
        _say(console, f"breaks off at {told.end:g} s; {hint}")
    elif not told.lost:
        _say(console, "lost: nothing")
    for problem in told.problems:
        _say(console, f"damage: {problem}")
    _say(console, f"log: {told.log}")


def logged_flight_summary(flight: LoggedFlight) -> dict[str, Any]:
    """A read flight's figures as JSON values, named as those of a flight just flown."""
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
    told = {name: printable(text) for name, text in flight.metadata.items()}
    lines = [
        f"flown {told.get('started', 'at an unknown time')} with moflock {told.get('moflock_version', '?')}, "
        f"MuJoCo {told.get('mujoco_version', '?')}, on {told.get('cpu') or 'an unknown processor'}"
    ]
    levels = Counter(event.level for event in flight.events)
    if levels:
        counts = ", ".join(f"{count} {level}" for level, count in sorted(levels.items()))
        lines.append(f"events: {counts}")
    if flight.dynamics == DEPLOYED:
        lines += _latency_lines(flight.result.get("latency", ""))
    if flight.start:
        lines.append(f"resumed at {flight.start:g} s from {told.get(RESUMED_FROM, 'another log')}")
    if flight.missing:
        lines.append(f"recovered; {flight.missing:g} s in between are lost")
    lines.append(f"log: {flight.log}")
    if not flight.complete:
        reason = f": {printable(flight.result['error'])}" if "error" in flight.result else ""
        lines.append(f"ended at {flight.flown:g} s of {flight.scenario.duration:g} s{reason}")
    return lines


def _latency_lines(text: str) -> list[str]:
    """What a deployment's log says of its setpoints, if they are figures."""
    try:
        figures = LatencyFigures(**json.loads(text))
        return [figures.sentence()]
    except (ValueError, TypeError):
        return []


def _where(difference: Difference) -> str:
    which = "" if difference.drone is None else f" of drone {difference.drone}"
    return f"{difference.what}{which} at {difference.time:g} s (sample {difference.tick})"


def _say(console: Console, line: str) -> None:
    """Print a line as it is: what a file says is no markup."""
    console.print(line, highlight=False, markup=False, soft_wrap=True)
