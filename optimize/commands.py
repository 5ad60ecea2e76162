"""The search's verbs of the command `moflock`: their options, and nothing else; what they do is in `verbs`."""

from __future__ import annotations

import enum
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moflock_mj.errors import SearchError
from moflock_mj.options import AsJson, Drones, Dynamics, ScenarioFile, given_scenario

if TYPE_CHECKING:
    from moflock_mj.bounds import Bounds
    from optimize.configuration import Configuration

commands = typer.Typer()


class Algorithm(enum.StrEnum):
    """Who searches."""

    NSGA2 = "nsga2"
    UNSGA3 = "unsga3"
    CMAES = "cmaes"
    PSO = "pso"


class Noise(enum.StrEnum):
    """What is done about the scatter from seed to seed."""

    REFLY = "refly"
    COMMON = "common"
    FIXED = "fixed"


class Sampling(enum.StrEnum):
    """How random points are drawn."""

    UNIFORM = "uniform"
    LATIN_HYPERCUBE = "latin_hypercube"


Duration = Annotated[float | None, typer.Option(help="Simulated seconds of each flight.")]
BoundsFile = Annotated[Path | None, typer.Option("--bounds", help="TOML or JSON file; the paper's if absent.")]
Workers = Annotated[int, typer.Option(help="Local processes.")]
Scheduler = Annotated[str | None, typer.Option(help="Fly on a Dask cluster instead, at tcp://host:port.")]
RunPath = Annotated[Path, typer.Argument(help="A search's directory.", metavar="RUN")]

CORES = os.cpu_count() or 1
_FRONT_SEEDS = 100
FrontSeeds = Annotated[
    int | None,
    typer.Option(help=f"Fly the front again if it has flown fewer fresh seeds; {_FRONT_SEEDS} if it has none.", min=2),
]


@commands.command("pca", epilog="Example: moflock pca --drones 10 --out logs/objectives.json")
def pca_command(
    points: Annotated[int, typer.Option(help="Random points to be flown.")] = 500,
    sampling: Annotated[Sampling, typer.Option(help="How they are drawn.")] = Sampling.UNIFORM,
    seed: Annotated[int, typer.Option(help="Of points and flights.")] = 1,
    dynamics: Annotated[Dynamics, typer.Option(help="What moves the drones.")] = Dynamics.POINT_MASS,
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Duration = None,
    bounds: BoundsFile = None,
    workers: Workers = CORES,
    scheduler: Scheduler = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Objectives for optimize, .json; a figure and the flights, .flights, go beside it."),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Group the six fitnesses into objectives by principal component analysis.

    Flights are kept beside --out, or in logs/: the same command goes on after Ctrl-C.
    """
    from optimize import verbs  # noqa: PLC0415 - loads the search's libraries

    return verbs.pca(
        scenario=given_scenario(scenario, drones=drones, duration=duration),
        dynamics=dynamics.value,
        bounds=given_bounds(bounds),
        points=points,
        seed=seed,
        sampling=sampling.value,
        workers=workers,
        scheduler=scheduler,
        out=out,
        as_json=as_json,
    )


_OPTIMIZE_EXAMPLE = (
    "Example: moflock optimize --algorithm nsga2 --budget 2000; moflock optimize --dynamics rigid_body --screen "
    "--start-from logs/optimize-...; moflock optimize --resume RUN"
)


@commands.command("optimize", epilog=_OPTIMIZE_EXAMPLE)
def optimize_command(
    algorithm: Annotated[Algorithm | None, typer.Option(help="Who searches; nsga2 if absent.")] = None,
    budget: Annotated[int | None, typer.Option(help="Flights; 2000 if absent.")] = None,
    population: Annotated[int | None, typer.Option(help="Points per generation; 50 if absent.")] = None,
    seeds: Annotated[int | None, typer.Option(help="Flights per evaluation; 1 if absent.")] = None,
    noise: Annotated[
        Noise | None, typer.Option(help="New seeds for each evaluation, common ones, or fixed ones; refly if absent.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Of the search; 1 if absent.")] = None,
    dynamics: Annotated[Dynamics | None, typer.Option(help="What moves the drones; point_mass if absent.")] = None,
    objectives: Annotated[Path | None, typer.Option(help="File that moflock pca wrote; the paper's if absent.")] = None,
    coverage: Annotated[bool, typer.Option("--coverage", help="Maximise the share of the arena that is seen too.")] = (
        False
    ),
    unbounded: Annotated[bool, typer.Option("--unbounded", help="Let cmaes leave the bounds.")] = False,
    screen: Annotated[
        bool, typer.Option("--screen", help="Fly all that is bred on point masses, and only the promising on bodies.")
    ] = False,
    start_from: Annotated[
        list[str] | None,
        typer.Option(help="Begin with this point or search's front: named, .json, directory; may repeat."),
    ] = None,
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Duration = None,
    bounds: BoundsFile = None,
    timeout: Annotated[float | None, typer.Option(help="Wall time of an evaluation, s; 600 if absent.")] = None,
    front_seeds: Annotated[int, typer.Option(help="Fresh seeds for the front at the end; 0 for none.", min=0)] = (
        _FRONT_SEEDS
    ),
    workers: Workers = CORES,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, typer.Option(help="Run directory; a new one in logs/ if absent.")] = None,
    resume: Annotated[Path | None, typer.Option(help="Go on with this run.", metavar="RUN")] = None,
    as_json: AsJson = False,
) -> int:
    """Search the 12 parameters, and fly the front that was found again on fresh seeds."""
    from optimize import verbs  # noqa: PLC0415 - loads the search's libraries
    from optimize.terminal import new_run_path  # noqa: PLC0415

    if front_seeds == 1:
        raise SearchError("front_seeds: 1 is out of bounds: it must be 0 or at least 2")
    settings: dict[str, Any] = {
        "algorithm": algorithm,
        "budget": budget,
        "population": population,
        "seeds": seeds,
        "noise": noise,
        "seed": seed,
        "dynamics": dynamics,
        "unbounded": unbounded or None,
        "screen": screen or None,
        "timeout": timeout,
    }
    given = {name: value for name, value in settings.items() if value is not None}
    files: dict[str, Any] = {
        "objectives": objectives,
        "scenario": scenario,
        "drones": drones,
        "duration": duration,
        "bounds": bounds,
        "start_from": start_from or None,
    }
    if resume is not None:
        refuse_with_resume(given | files | {"out": out, "coverage": coverage or None})
        configuration, path = None, resume
    else:
        configuration = _configuration(given, coverage=coverage, **files)
        path = out or new_run_path(configuration.settings.algorithm)
    return verbs.optimize(path, configuration, workers=workers, scheduler=scheduler, seeds=front_seeds, as_json=as_json)


@commands.command("pick", epilog="Example: moflock pick logs/optimize-... --min-f1 0.8 --out point.json")
def pick_command(
    run: RunPath,
    weights: Annotated[str | None, typer.Option(help="Of the objectives, such as 1,2: best weighted sum.")] = None,
    min_f1: Annotated[float | None, typer.Option(help="Best second objective with at least this first one.")] = None,
    knee: Annotated[bool, typer.Option("--knee", help="The knee of the front, which is the default.")] = False,
    seeds: FrontSeeds = None,
    workers: Workers = CORES,
    out: Annotated[Path | None, typer.Option(help="Point as .json; stdout if absent.")] = None,
    as_json: AsJson = False,
) -> int:
    """Choose a point of a run's front: JSON that fly and the other verbs take as --point."""
    from optimize import verbs  # noqa: PLC0415

    asked = {"weights": weights is not None, "min_f1": min_f1 is not None, "knee": knee}
    if sum(asked.values()) > 1:
        both = " and ".join(name for name, wanted in asked.items() if wanted)
        raise SearchError(f"pick: {both} are both given; it must be one of them")
    return verbs.pick(
        run,
        weights=numbers_of("weights", weights) if weights is not None else None,
        min_f1=min_f1,
        seeds=seeds,
        workers=workers,
        out=out,
        as_json=as_json,
    )


@commands.command("report", epilog="Example: moflock report logs/optimize-... --compare logs/optimize-...-cmaes")
def report_command(
    run: RunPath,
    compare: Annotated[list[Path] | None, typer.Option(help="Another run of the same scenario; may repeat.")] = None,
    seeds: FrontSeeds = None,
    workers: Workers = CORES,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, typer.Option(help="Folder; RUN/report if absent.")] = None,
    as_json: AsJson = False,
) -> int:
    """Write a run's report: one HTML page with all figures, and their PNGs."""
    from optimize import verbs  # noqa: PLC0415

    return verbs.report(
        run, compared=compare or (), seeds=seeds, workers=workers, scheduler=scheduler, out=out, as_json=as_json
    )


@commands.command("target", epilog="Example: moflock target A B --at 250,250 --picture target.png")
def target_command(
    points: Annotated[list[str], typer.Argument(help="Named points or .json files.", metavar="POINT...")],
    at: Annotated[str, typer.Option(help="Where the target stands, x,y in m.")] = "250,250",
    dynamics: Annotated[Dynamics, typer.Option(help="What moves the drones.")] = Dynamics.POINT_MASS,
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Duration = None,
    seed: Annotated[int, typer.Option(help="Of all random numbers.")] = 1,
    picture: Annotated[Path | None, typer.Option(help="Figure of distance over time with the fitted sine.")] = None,
    as_json: AsJson = False,
) -> int:
    """Fly flocks around a target and fit the oscillation of their distance to it."""
    from optimize import verbs  # noqa: PLC0415

    place = numbers_of("at", at)
    if len(place) != 2:
        raise SearchError(f"at: {at!r} is of the wrong type: it must be two numbers, x,y")
    return verbs.target(
        points,
        place=(place[0], place[1]),
        scenario=given_scenario(scenario, drones=drones, duration=duration),
        dynamics=dynamics.value,
        seed=seed,
        out=picture,
        as_json=as_json,
    )


def _configuration(
    given: dict[str, Any],
    *,
    coverage: bool,
    objectives: Path | None,
    scenario: Path | None,
    drones: int | None,
    duration: float | None,
    bounds: Path | None,
    start_from: list[str] | None,
) -> Configuration:
    from moflock_mj.identification import calibrated  # noqa: PLC0415
    from optimize.configuration import Configuration, Settings, search_scenario  # noqa: PLC0415
    from optimize.objectives import PAPER, load_objectives  # noqa: PLC0415
    from optimize.point_sources import read_points  # noqa: PLC0415

    settings = Settings(**given)
    flown = search_scenario(given_scenario(scenario, drones=drones, duration=duration), settings.dynamics)
    if settings.screen:
        flown = calibrated(flown)
    wanted = load_objectives(objectives, flown) if objectives else PAPER
    return Configuration(
        scenario=flown,
        bounds=given_bounds(bounds),
        objectives=wanted.with_coverage() if coverage else wanted,
        settings=settings,
        start=tuple(read_points(start_from or [])[0].values()),
    )


def refuse_with_resume(given: Mapping[str, Any]) -> None:
    """Refuse what a run that is resumed has of its own already; None for what was not given.

    Raises:
        SearchError: something was given.
    """
    for name, value in given.items():
        if value is not None:
            raise SearchError(f"resume: the run has its own {name}, which cannot be given again")


def given_bounds(path: Path | None) -> Bounds:
    """The bounds of a file, or the paper's."""
    from moflock_mj.bounds import load_bounds, paper_bounds  # noqa: PLC0415

    return load_bounds(path) if path else paper_bounds()


def numbers_of(name: str, text: str) -> list[float]:
    """Numbers of a text such as 250,250."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise SearchError(f"{name}: {text!r} is of the wrong type: it must be numbers with commas between") from None
