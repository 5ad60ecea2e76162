"""Command `moflock pca`: grouping of the six fitnesses into objectives."""

from __future__ import annotations

import enum
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moflock_mj.cli.options import AsJson, Drones, Dynamics, ScenarioFile, given_scenario
from optimize.cli.options import CORES, BoundsFile, Duration, Scheduler, Workers, given_bounds

if TYPE_CHECKING:
    from moflock_mj.parameters.bounds import ParameterBounds
    from moflock_mj.scenario.scenario import Scenario
    from optimize.analysis.pca import Agreement, PrincipalComponents
    from optimize.evaluation.objectives import Objectives

commands = typer.Typer()


class Sampling(enum.StrEnum):
    """Sampling of random points."""

    UNIFORM = "uniform"
    LATIN_HYPERCUBE = "latin_hypercube"


@commands.command("pca", epilog="Example: moflock pca --drones 10 --out logs/objectives.json")
def pca_command(
    points: Annotated[int, typer.Option(help="Number of random points.")] = 500,
    sampling: Annotated[Sampling, typer.Option(help="Sampling of the points.")] = Sampling.UNIFORM,
    seed: Annotated[int, typer.Option(help="Seed of the points and their flights.")] = 1,
    dynamics: Annotated[Dynamics, typer.Option(help="Model of the drones.")] = Dynamics.POINT_MASS,
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Duration = None,
    bounds: BoundsFile = None,
    workers: Workers = CORES,
    scheduler: Scheduler = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Output file with objectives for optimize, .json; a figure and the flights are put beside it."
        ),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Group the six fitnesses into objectives by principal component analysis.

    Flights are archived beside --out or in logs/, so the same command resumes after Ctrl-C.
    """
    return pca(
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


def pca(
    *,
    scenario: Scenario,
    dynamics: str,
    bounds: ParameterBounds,
    points: int,
    seed: int,
    sampling: str,
    workers: int,
    scheduler: str | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Fly random points, analyse their fitnesses, and print the matrices.

    `out` is a JSON file for `optimize`; a figure and a folder with the flights are put beside it. If it is None, only
    the flights are stored, in `logs/`.

    Raises:
        MoflockError: the points cannot be flown, or a file cannot be written.
    """
    from moflock_mj.files import new_file
    from optimize.analysis.pca import agreement, components_json, grouped_by_sign, study
    from optimize.analysis.published_results import FIRST_COMPONENT
    from optimize.cli.console import flights_progress
    from optimize.evaluation.batch import check_counts
    from optimize.evaluation.evaluation import Job, search_scenario
    from optimize.evaluation.resumable import Study, open_resumable
    from optimize.reports.figures import components_figure, save

    check_counts(points=points)
    scenario = search_scenario(scenario, dynamics)
    job = Job(scenario=scenario, dynamics=dynamics, policy=bounds.policy)
    settings = {"dynamics": dynamics, "bounds": bounds.to_dict(), "points": points, "seed": seed, "sampling": sampling}
    request = Study(command="pca", scenario=scenario, settings=settings)
    folder = out.with_suffix(".flights") if out else request.default_folder()
    with open_resumable(request, folder, job, workers, scheduler) as flights:
        with flights_progress("random points") as progress:
            found, _ = study(flights, bounds, points=points, seed=seed, sampling=sampling, progress=progress)
        objectives = grouped_by_sign(found, scenario)
        if out is not None:
            with new_file(out) as place:
                place.write_text(components_json(found, objectives), encoding="utf-8")
            labels = [f"F_{name}" for name in found.names]
            save(
                lambda: components_figure(found, labels, "Covariance of the fitnesses", FIRST_COMPONENT),
                out.with_suffix(".png"),
            )
    near = agreement(found)
    if as_json:
        print(json.dumps({**json.loads(components_json(found, objectives)), "agreement": near._asdict()}, indent=1))
    else:
        _print_components(found, objectives, near)
        print(f"flights: {folder}")
    return 0


def _print_components(found: PrincipalComponents, objectives: Objectives, near: Agreement) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("", "w", *(f"F_{name}" for name in found.names), title=f"{found.samples} random points: w and K")
    for name, weight, row in zip(found.names, found.components[0], found.covariance, strict=True):
        table.add_row(f"F_{name}", f"{weight:.3f}", *(f"{value:.3f}" for value in row))
    console = Console()
    console.print(table)
    console.print("explained variance, %: " + ", ".join(f"{100 * share:.1f}" for share in found.explained))
    for name, group in zip(objectives.names, objectives.groups, strict=True):
        console.print(f"{name} = " + " ".join(f"F_{member}" for member in group), highlight=False)
    for name in found.constant:
        console.print(f"F_{name} is constant", highlight=False)
    signs = "same signs" if near.same_signs else "different signs"
    console.print(
        f"compared with the paper: cosine {near.cosine:.3f}, {signs}, "
        f"mean difference of the covariance {near.covariance_error:.3f}",
        highlight=False,
    )
