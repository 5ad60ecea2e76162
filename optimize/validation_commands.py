"""The verbs that judge points before they fly: their options, and nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from moflock_mj.errors import SearchError
from optimize.commands import CORES, AsJson, Drones, Duration, ScenarioFile, Scheduler, Workers, given_scenario

commands = typer.Typer()

_SEEDS = 20

_VALIDATE_EXAMPLE = "Example: moflock validate A knee logs/optimize-... --seeds 20; moflock validate --resume RUN"


@commands.command("validate", epilog=_VALIDATE_EXAMPLE)
def validate_command(
    points: Annotated[
        list[str] | None, typer.Argument(help="Named points, .json files, searches' directories.", metavar="POINT...")
    ] = None,
    seeds: Annotated[int | None, typer.Option(help="Flights of each point on each dynamics; 20 if absent.")] = None,
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Duration = None,
    workers: Workers = CORES,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, typer.Option(help="Directory; a new one in logs/ if absent.")] = None,
    resume: Annotated[Path | None, typer.Option(help="Go on with this validation.", metavar="RUN")] = None,
    logs: Annotated[bool, typer.Option(help="Log the worst seed of each point.")] = True,
    as_json: AsJson = False,
) -> int:
    """Fly points on point masses and on rigid bodies, and say which are safe to fly."""
    from optimize.validation import make_settings  # noqa: PLC0415 - loads the search's libraries
    from optimize.validation_verbs import new_validation_path, validate  # noqa: PLC0415

    if resume is not None:
        given: dict[str, Any] = {"points": points or None, "seeds": seeds, "scenario": scenario}
        given |= {"drones": drones, "duration": duration, "out": out}
        own = [name for name, value in given.items() if value is not None]
        if own:
            raise SearchError(f"resume: the run has its own {own[0]}, which cannot be given again")
        settings, path = None, resume
    else:
        flown = given_scenario(scenario, drones=drones, duration=duration)
        settings = make_settings(flown, points or [], _SEEDS if seeds is None else seeds)
        path = out or new_validation_path()
    return validate(path, settings, workers=workers, scheduler=scheduler, logs=logs, as_json=as_json)


@commands.command("identify", epilog="Example: moflock identify x500 --out calibrated.toml")
def identify_command(
    airframe: Annotated[str, typer.Argument(help="x500, crazyflie.")],
    scenario: ScenarioFile = None,
    out: Annotated[Path | None, typer.Option(help="Scenario with the calibrated point mass, .toml.")] = None,
    as_json: AsJson = False,
) -> int:
    """Fit the point mass's tau, a_max and delay to an airframe with its controllers."""
    from optimize.validation_verbs import identify_airframe  # noqa: PLC0415

    return identify_airframe(given_scenario(scenario, airframe=airframe), out=out, as_json=as_json)
