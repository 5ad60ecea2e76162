"""Commands `moflock sensitivity` and `moflock sweep`: dependence of the fitnesses on parameters and scenario."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from moflock_mj.cli.options import AsJson, Drones, Dynamics, ScenarioFile, given_scenario
from moflock_mj.errors import SearchError
from optimize.cli.options import (
    CORES,
    BoundsFile,
    Duration,
    Scheduler,
    Workers,
    given_bounds,
    numbers_of,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from moflock_mj.parameters.bounds import ParameterBounds
    from moflock_mj.scenario.scenario import Scenario
    from optimize.analysis.sensitivity import OneAtATime, SobolIndices, Sweep
    from optimize.reports.tables import Words

commands = typer.Typer()


@commands.command("sensitivity", epilog="Example: moflock sensitivity knee --samples 64 --out logs/sensitivity")
def sensitivity_command(
    point: Annotated[
        str, typer.Argument(help="Named point or .json file, for the study of one parameter at a time.")
    ] = "knee",
    samples: Annotated[int, typer.Option(help="Base samples of the Sobol indices; each requires 14 flights.")] = 64,
    levels: Annotated[int, typer.Option(help="Number of values of each parameter when one is varied at a time.")] = 9,
    seeds: Annotated[int, typer.Option(help="Flights at each of these values.")] = 10,
    dynamics: Annotated[Dynamics, typer.Option(help="Model of the drones.")] = Dynamics.POINT_MASS,
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Duration = None,
    bounds: BoundsFile = None,
    workers: Workers = CORES,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, typer.Option(help="Output folder (default: a folder of this study in logs/).")] = None,
    as_json: AsJson = False,
) -> int:
    """Compute Sobol indices of the six fitnesses, and vary one parameter at a time around a point.

    Flights are archived in the folder, so the same command resumes after Ctrl-C.
    """
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
    t_del: Annotated[str | None, typer.Option(help="Communication delays, s, such as 0,0.5,1,2.")] = None,
    arena_side: Annotated[str | None, typer.Option(help="Sides of the arena, m, such as 200,300,500.")] = None,
    seeds: Annotated[int, typer.Option(help="Flights at each value.")] = 10,
    dynamics: Annotated[Dynamics, typer.Option(help="Model of the drones.")] = Dynamics.POINT_MASS,
    scenario: ScenarioFile = None,
    duration: Duration = None,
    workers: Workers = CORES,
    scheduler: Scheduler = None,
    out: Annotated[Path | None, typer.Option(help="Output folder (default: a folder of this study in logs/).")] = None,
    as_json: AsJson = False,
) -> int:
    """Fly a point with several numbers of drones, delays or arena sizes.

    Flights are archived in the folder, so the same command resumes after Ctrl-C.
    """
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


def sensitivity(
    point: str,
    *,
    scenario: Scenario,
    dynamics: str,
    bounds: ParameterBounds,
    samples: int,
    levels: int,
    seeds: int,
    workers: int,
    scheduler: str | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Fly both studies, print the indices, and write JSON, a figure and the flights into the folder `out`.

    Raises:
        MoflockError: the points cannot be flown, or a file cannot be written.
    """
    from rich.console import Console

    from controllers.policies.registry import spec_of, values_of
    from moflock_mj.files import new_file
    from moflock_mj.parameters.points import load_point
    from optimize.analysis.sensitivity import check_samples, one_at_a_time, sobol_indices
    from optimize.cli.console import flights_progress
    from optimize.evaluation.batch import check_counts, fresh_seeds
    from optimize.evaluation.evaluation import Job, search_scenario
    from optimize.evaluation.resumable import Study, open_resumable
    from optimize.reports.figures import save
    from optimize.reports.sensitivity_figures import sensitivity_figure
    from optimize.reports.tables import rich_table

    params = load_point(point)
    check_samples(samples)
    check_counts(levels=levels, seeds=seeds)
    if bounds.policy != spec_of(params).name:
        raise SearchError(f"bounds: policy {bounds.policy!r}: it must be that of the point, {spec_of(params).name!r}")
    job = Job(scenario=search_scenario(scenario, dynamics), dynamics=dynamics, policy=bounds.policy)
    sizes = {"samples": samples, "levels": levels, "seeds": seeds}
    settings = {
        "policy": spec_of(params).name,
        "point": values_of(params),
        "dynamics": dynamics,
        "bounds": bounds.to_dict(),
        **sizes,
    }
    study = Study(command="sensitivity", scenario=job.scenario, settings=settings)
    out = out or study.default_folder()
    with open_resumable(study, out, job, workers, scheduler) as flights:
        with flights_progress("Sobol indices") as progress:
            indices = sobol_indices(flights, bounds, samples=samples, progress=progress)
        with flights_progress("one at a time") as progress:
            along = one_at_a_time(flights, params, bounds, seeds=fresh_seeds(seeds), levels=levels, progress=progress)
        content = json.dumps(_content(point, params, indices, along, seeds), indent=1) + "\n"
        with new_file(out / "sensitivity.json") as place:
            place.write_text(content, encoding="utf-8")
        save(lambda: sensitivity_figure(indices, along, params), out / "sensitivity.png")
    if as_json:
        print(content, end="")
        return 0
    console = Console()
    console.print(rich_table(_table("First order", list(values_of(params)), indices.first, indices.first_width)))
    console.print(rich_table(_table("Total", list(values_of(params)), indices.total, indices.total_width)))
    console.print(f"figure and JSON: {out}", highlight=False, soft_wrap=True)
    return 0


def sweeps(
    point: str,
    fields: Mapping[str, Sequence[float]],
    *,
    scenario: Scenario,
    dynamics: str,
    seeds: int,
    workers: int,
    scheduler: str | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Fly a point over values of scenario fields, print the means, and write JSON, figures and flights into `out`.

    Raises:
        MoflockError: the points cannot be flown, or a file cannot be written.
    """
    from rich.console import Console

    from controllers.policies.registry import spec_of, values_of
    from moflock_mj.files import new_file
    from moflock_mj.parameters.points import load_point
    from optimize.analysis.sensitivity import sweep, swept_scenarios
    from optimize.cli.console import flights_progress
    from optimize.evaluation.batch import check_counts, fresh_seeds
    from optimize.evaluation.evaluation import Job
    from optimize.evaluation.resumable import Study, open_resumable
    from optimize.reports.figures import save
    from optimize.reports.sensitivity_figures import sweep_figure
    from optimize.reports.tables import rich_table

    params = load_point(point)
    if not fields:
        raise SearchError("sweep: no field is given; it must be at least one, such as --drones 5,10,30")
    check_counts(seeds=seeds)
    scenarios = {name: swept_scenarios(params, scenario, name, values, dynamics) for name, values in fields.items()}
    variants = tuple(itertools.chain.from_iterable(scenarios.values()))
    job = Job(scenario=variants[0], dynamics=dynamics, policy=spec_of(params).name, variants=variants)
    settings = {
        "policy": spec_of(params).name,
        "point": values_of(params),
        "dynamics": dynamics,
        "seeds": seeds,
        "sweeps": dict(fields),
    }
    study = Study(command="sweep", scenario=scenario, settings=settings)
    out = out or study.default_folder()
    number = itertools.count()
    found = []
    with open_resumable(study, out, job, workers, scheduler) as flights:
        for name, values in fields.items():
            own = [next(number) for _ in values]
            with flights_progress(name) as progress:
                found.append(
                    sweep(flights, params, name, values, variants=own, seeds=fresh_seeds(seeds), progress=progress)
                )
            save(partial(sweep_figure, found[-1], _field_unit(name)), out / f"{name}.png")
        swept = {one.field: {"values": list(fields[one.field]), "fitness": one.fitness.tolist()} for one in found}
        content = {"point": point, "dynamics": dynamics, "seeds": list(fresh_seeds(seeds)), "sweeps": swept}
        text = json.dumps(content, indent=1) + "\n"
        with new_file(out / "sweeps.json") as place:
            place.write_text(text, encoding="utf-8")
    if as_json:
        print(text, end="")
        return 0
    console = Console()
    for one in found:
        console.print(rich_table(_means(one)))
    console.print(f"figures and JSON: {out}", highlight=False, soft_wrap=True)
    return 0


def _field_unit(name: str) -> str:
    from moflock_mj.scenario.scenario import Scenario

    return str(next(field.metadata["bounds"].unit for field in dataclasses.fields(Scenario) if field.name == name))


def _means(found: Sweep) -> Words:
    """Table with a row for each value and a column for each fitness."""
    from optimize.analysis.statistics import half_width
    from optimize.evaluation.objectives import FITNESS_NAMES
    from optimize.reports.tables import Words

    pairs = zip(found.values, found.fitness.mean(axis=1), half_width(found.fitness, axis=1), strict=True)
    rows = [
        (f"{value:g}", *(f"{mean:.3f} ± {width:.3f}" for mean, width in zip(means, widths, strict=True)))
        for value, means, widths in pairs
    ]
    return Words(found.field, (found.field, *(f"F_{name}" for name in FITNESS_NAMES)), rows)


def _content(point: str, params: NamedTuple, indices: SobolIndices, along: OneAtATime, seeds: int) -> dict[str, Any]:
    from controllers.policies.registry import values_of
    from optimize.evaluation.batch import fresh_seeds
    from optimize.evaluation.objectives import FITNESS_NAMES

    arrays = {name: _lists(values) for name, values in indices._asdict().items() if name != "points"}
    return {
        "fitnesses": list(FITNESS_NAMES),
        "parameters": list(values_of(params)),
        "sobol": arrays | {"points": indices.points},
        "one_at_a_time": {
            "point": point,
            "params": values_of(params),
            "seeds": list(fresh_seeds(seeds)),
            "values": along.values.tolist(),
            "fitness": along.fitness.tolist(),
        },
    }


def _lists(values: NDArray[np.float64]) -> list[list[float | None]]:
    import numpy as np

    return [[value if np.isfinite(value) else None for value in row] for row in values.tolist()]


def _table(title: str, names: Sequence[str], values: NDArray[np.float64], widths: NDArray[np.float64]) -> Words:
    """Table with a row for each parameter and a column for each fitness."""
    from optimize.evaluation.objectives import FITNESS_NAMES
    from optimize.reports.tables import Words

    rows = [
        (name, *(f"{value:.2f} ± {width:.2f}" for value, width in zip(values[:, k], widths[:, k], strict=True)))
        for k, name in enumerate(names)
    ]
    return Words(title, ("parameter", *(f"F_{name}" for name in FITNESS_NAMES)), rows)
