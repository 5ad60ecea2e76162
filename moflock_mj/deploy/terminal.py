"""What a deployment looks like in a terminal: events as they come, Ctrl-C, the flight's figures."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from typing import Any

from rich.console import Console

from moflock_mj.deploy.deployment import Check, Deployed, DeployPlan, Wishes, deploy
from moflock_mj.deploy.member import Stage
from moflock_mj.errors import CheckFailedError
from moflock_mj.events import FlightEvent
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.terminal import INTERRUPTED, figures_table

FAILED = 1
"""Exit status: a check failed, or the flight did."""

_SWITCH = 0.0005
"""s, after which a thread lets another one go on."""


def run_deployment(plan: DeployPlan, key: SigningKey | None, check: Check | None, *, as_json: bool) -> int:
    """Deploy a flock; returns the exit status.

    Raises:
        MoflockError: nobody was armed, because of this.
    """
    console = Console(highlight=False, soft_wrap=True)

    def say(event: FlightEvent) -> None:
        if not as_json:
            console.print(f"{event.time_ns / 1e9:7.1f} s  {_mark(event)}{event.message}", markup=False)

    # The log's thread must not keep a setpoint waiting.
    sys.setswitchinterval(_SWITCH)
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
    """A deployment as JSON values, named as those of a simulated flight where they are the same."""
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
    whole = asyncio.current_task()
    assert whole is not None
    wishes = Wishes(whole.cancel)
    with _wishes_by_signal(wishes):
        return await deploy(plan, key, wishes, check=check, say=say)


@contextlib.contextmanager
def _wishes_by_signal(wishes: Wishes) -> Iterator[None]:
    """Turn Ctrl-C and SIGTERM into wishes; before anybody is armed, into an end."""
    loop = asyncio.get_running_loop()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        loop.add_signal_handler(number, wishes.press)
    try:
        yield
    finally:
        for number, handler in before.items():
            loop.remove_signal_handler(number)
            signal.signal(number, handler)


def _print_deployment(console: Console, deployed: Deployed) -> None:
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
        console.print(f"it failed: {deployed.error}", markup=False)


def _mark(event: FlightEvent) -> str:
    return "" if event.level == "info" else f"{event.level}: "
