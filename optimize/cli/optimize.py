"""Command `moflock optimize`: search of a policy's parameters."""

from __future__ import annotations

import contextlib
import enum
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moflock_mj.cli.options import AsJson, Drones, Dynamics, ScenarioFile, given_scenario
from moflock_mj.errors import SearchError
from optimize.cli.options import (
    CORES,
    FRONT_SEEDS,
    BoundsFile,
    Duration,
    Scheduler,
    Workers,
    given_bounds,
    refuse_with_resume,
)

if TYPE_CHECKING:
    from optimize.search.configuration import Configuration

commands = typer.Typer()


class Algorithm(enum.StrEnum):
    """Search algorithm."""

    NSGA2 = "nsga2"
    UNSGA3 = "unsga3"
    CMAES = "cmaes"
    PSO = "pso"


class Noise(enum.StrEnum):
    """Treatment of the noise between seeds."""

    REFLY = "refly"
    COMMON = "common"
    FIXED = "fixed"


_OPTIMIZE_EXAMPLE = (
    "Example: moflock optimize --algorithm nsga2 --budget 2000; moflock optimize --dynamics rigid_body --screen "
    "--start-from logs/optimize-...; moflock optimize --resume RUN"
)


@commands.command("optimize", epilog=_OPTIMIZE_EXAMPLE)
def optimize_command(
    algorithm: Annotated[Algorithm | None, typer.Option(help="Search algorithm (default: nsga2).")] = None,
    budget: Annotated[int | None, typer.Option(help="Number of flights (default: 2000).")] = None,
    population: Annotated[int | None, typer.Option(help="Points per generation (default: 50).")] = None,
    seeds: Annotated[int | None, typer.Option(help="Flights per evaluation (default: 1).")] = None,
    noise: Annotated[
        Noise | None,
        typer.Option(help="Seeds: new for each evaluation (refly, default) or generation (common), or fixed."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the search (default: 1).")] = None,
    dynamics: Annotated[Dynamics | None, typer.Option(help="Model of the drones (default: point_mass).")] = None,
    objectives: Annotated[
        Path | None, typer.Option(help="Objectives from moflock pca, .json (default: the paper's).")
    ] = None,
    coverage: Annotated[bool, typer.Option("--coverage", help="Also maximise the share of the arena that is seen.")] = (
        False
    ),
    unbounded: Annotated[bool, typer.Option("--unbounded", help="Allow cmaes to leave the bounds.")] = False,
    screen: Annotated[
        bool,
        typer.Option("--screen", help="Fly all offspring as point masses, and the most promising as rigid bodies."),
    ] = False,
    start_from: Annotated[
        list[str] | None,
        typer.Option(
            help="Start from a named point, a .json file or the front of a search directory; may be repeated."
        ),
    ] = None,
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Duration = None,
    bounds: BoundsFile = None,
    timeout: Annotated[float | None, typer.Option(help="Wall time limit of an evaluation, s (default: 600).")] = None,
    front_seeds: Annotated[
        int, typer.Option(help="Fresh seeds for the re-evaluation of the front; 0 to skip it.", min=0)
    ] = FRONT_SEEDS,
    workers: Workers = CORES,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, typer.Option(help="Run directory (default: a new one in logs/).")] = None,
    resume: Annotated[Path | None, typer.Option(help="Resume this run.", metavar="RUN")] = None,
    as_json: AsJson = False,
) -> int:
    """Search the policy's parameters, and fly the resulting front again on fresh seeds."""
    from optimize.cli.console import new_run_path

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
    return optimize(path, configuration, workers=workers, scheduler=scheduler, seeds=front_seeds, as_json=as_json)


def optimize(
    path: Path,
    configuration: Configuration | None,
    *,
    workers: int,
    scheduler: str | None,
    seeds: int,
    as_json: bool,
) -> int:
    """Search, then fly the front again on fresh seeds. Ctrl-C stops the search, which can be resumed.

    Args:
        path: a new run directory, or an existing one if `configuration` is None.
        configuration: configuration of a new search; None to resume.
        workers: number of local processes.
        scheduler: address of a Dask scheduler, which replaces local processes; or None.
        seeds: number of fresh seeds for the front; 0 to skip it.
        as_json: whether to print JSON.

    Returns:
        Exit status.

    Raises:
        MoflockError: the configuration is invalid, or a file cannot be read or written.
    """
    from moflock_mj.cli.console import stop_on_interrupt
    from moflock_mj.cli.options import INTERRUPTED
    from optimize.cli.console import flights_progress, front_summary, print_search, search_progress, search_summary
    from optimize.search.findings import flown_front
    from optimize.search.run_directory import RunDirectory
    from optimize.search.search import open_executors, search

    with contextlib.ExitStack() as resources:
        if configuration is None:
            run = resources.enter_context(RunDirectory.open(path))
            executor, screening = open_executors(run.configuration, workers, scheduler, resources)
        else:  # the workers first, so that a failure leaves no directory
            executor, screening = open_executors(configuration, workers, scheduler, resources)
            run = resources.enter_context(RunDirectory.create(path, configuration))
        if (damaged := run.count_damaged()) and not as_json:
            print(f"{damaged} evaluations of the archive are damaged and will be repeated", file=sys.stderr)
        with search_progress(run.configuration) as progress, stop_on_interrupt() as interrupted:
            result = search(run, executor, progress, interrupted, screening=screening)
        front = None
        if result.complete and seeds:
            with flights_progress("front on fresh seeds") as front_progress:
                front = flown_front(run, executor, seeds, front_progress)
    summary = search_summary(result, run.configuration, path)
    if as_json:
        print(json.dumps(summary | {"flown_front": front_summary(front) if front else None}, indent=1))
    else:
        print_search(result, run.configuration, path, front)
    return 0 if result.complete else INTERRUPTED


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
    from moflock_mj.analysis.identification import calibrated
    from optimize.evaluation.evaluation import search_scenario
    from optimize.evaluation.objectives import PAPER, load_objectives
    from optimize.search.configuration import Configuration, SearchConfig
    from optimize.search.parameter_sources import read_points

    settings = SearchConfig(**given)
    flown = search_scenario(given_scenario(scenario, drones=drones, duration=duration), settings.dynamics)
    if settings.screen:
        flown = calibrated(flown)
    maximised = load_objectives(objectives, flown) if objectives else PAPER
    return Configuration(
        scenario=flown,
        bounds=given_bounds(bounds),
        objectives=maximised.with_coverage() if coverage else maximised,
        settings=settings,
        start=tuple(read_points(start_from or [])[0].values()),
    )
