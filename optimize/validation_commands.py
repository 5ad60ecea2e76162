"""The verbs that judge points before they fly: their options, and nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from moflock_mj.options import AsJson, Drones, Dynamics, ScenarioFile, given_scenario
from optimize.commands import (
    CORES,
    BoundsFile,
    Duration,
    Scheduler,
    Workers,
    given_bounds,
    numbers_of,
    refuse_with_resume,
)

commands = typer.Typer()

_SEEDS = 20

_VALIDATE_EXAMPLE = "Example: moflock validate A knee logs/optimize-... --seeds 20; moflock validate --resume RUN"


@commands.command("validate", epilog=_VALIDATE_EXAMPLE)
def validate_command(
    points: Annotated[
        list[str] | None, typer.Argument(help="Named points, .json files, searches' directories.", metavar="POINT...")
    ] = None,
    seeds: Annotated[int | None, typer.Option(help="Flights of each point on each dynamics; 20 if absent.")] = None,
    faults: Annotated[bool, typer.Option("--faults", help="Fly the standard faults on bodies too.")] = False,
    fault_seeds: Annotated[int | None, typer.Option(help="Flights of each point with each fault; 5 if absent.")] = None,
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
    """Fly points on point masses and on rigid bodies, and say which are safe to fly and which faults they survive."""
    from optimize.validation import FAULT_SEEDS, make_settings  # noqa: PLC0415 - loads the search's libraries
    from optimize.validation_verbs import new_validation_path, validate  # noqa: PLC0415

    if resume is not None:
        given: dict[str, Any] = {"points": points or None, "seeds": seeds, "scenario": scenario}
        given |= {"drones": drones, "duration": duration, "out": out}
        given |= {"faults": faults or None, "fault_seeds": fault_seeds}
        refuse_with_resume(given)
        settings, path = None, resume
    else:
        flown = given_scenario(scenario, drones=drones, duration=duration)
        count = _SEEDS if seeds is None else seeds
        wanted = fault_seeds if fault_seeds is not None else min(FAULT_SEEDS, count) * faults
        settings = make_settings(flown, points or [], count, wanted)
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


@commands.command("sensitivity", epilog="Example: moflock sensitivity knee --samples 64 --out logs/sensitivity")
def sensitivity_command(
    point: Annotated[str, typer.Argument(help="Named point or .json file, for one parameter at a time.")] = "knee",
    samples: Annotated[int, typer.Option(help="Base samples of the Sobol indices; each takes 14 flights.")] = 64,
    levels: Annotated[int, typer.Option(help="Values of each parameter changed alone.")] = 9,
    seeds: Annotated[int, typer.Option(help="Flights of each of these values.")] = 10,
    dynamics: Annotated[Dynamics, typer.Option(help="What moves the drones.")] = Dynamics.POINT_MASS,
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Duration = None,
    bounds: BoundsFile = None,
    workers: Workers = CORES,
    scheduler: Scheduler = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder of figure, JSON and flights; this study's own in logs/ if absent.")
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Sobol indices of the six fitnesses to the 12 parameters, and one parameter at a time around a point.

    Flights are kept in the folder: the same command goes on after Ctrl-C.
    """
    from optimize.sensitivity_verbs import sensitivity  # noqa: PLC0415

    return sensitivity(
        point,
        scenario=given_scenario(scenario, drones=drones, duration=duration),
        dynamics=dynamics.value,
        bounds=given_bounds(bounds),
        samples=samples,
        levels=levels,
        seeds=seeds,
        workers=workers,
        scheduler=scheduler,
        out=out,
        as_json=as_json,
    )


@commands.command("sweep", epilog="Example: moflock sweep knee --drones 5,10,30,100 --t-del 0,0.5,1,2")
def sweep_command(
    point: Annotated[str, typer.Argument(help="Named point or .json file.")] = "knee",
    drones: Annotated[str | None, typer.Option(help="Numbers of drones, such as 5,10,30,100.")] = None,
    t_del: Annotated[str | None, typer.Option(help="Delays of communication, s, such as 0,0.5,1,2.")] = None,
    arena_side: Annotated[str | None, typer.Option(help="Sides of the arena, m, such as 200,300,500.")] = None,
    seeds: Annotated[int, typer.Option(help="Flights of each value.")] = 10,
    dynamics: Annotated[Dynamics, typer.Option(help="What moves the drones.")] = Dynamics.POINT_MASS,
    scenario: ScenarioFile = None,
    duration: Duration = None,
    workers: Workers = CORES,
    scheduler: Scheduler = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder of figures, JSON and flights; this study's own in logs/ if absent.")
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Fly a point in scenarios of other sizes, delays and arenas.

    Flights are kept in the folder: the same command goes on after Ctrl-C.
    """
    from optimize.sensitivity_verbs import sweeps  # noqa: PLC0415

    given = {"drones": drones, "t_del": t_del, "arena_side": arena_side}
    return sweeps(
        point,
        {name: numbers_of(name, text) for name, text in given.items() if text is not None},
        scenario=given_scenario(scenario, duration=duration),
        dynamics=dynamics.value,
        seeds=seeds,
        workers=workers,
        scheduler=scheduler,
        out=out,
        as_json=as_json,
    )
