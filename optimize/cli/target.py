"""Command `moflock target`: tracking of a target by a flock."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moflock_mj.cli.options import AsJson, Drones, Dynamics, ScenarioFile, given_scenario
from moflock_mj.errors import SearchError
from optimize.cli.options import Duration, numbers_of

if TYPE_CHECKING:
    from moflock_mj.scenario.scenario import Scenario

commands = typer.Typer()


@commands.command("target", epilog="Example: moflock target A B --at 250,250 --picture target.png")
def target_command(
    points: Annotated[list[str], typer.Argument(help="Named points or .json files.", metavar="POINT...")],
    at: Annotated[str, typer.Option(help="Position of the target, x,y in m.")] = "250,250",
    dynamics: Annotated[Dynamics, typer.Option(help="Model of the drones.")] = Dynamics.POINT_MASS,
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Duration = None,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.")] = 1,
    picture: Annotated[
        Path | None, typer.Option(help="Output file for a figure of the distance over time and the fitted sine, .png.")
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Fly flocks around a target and fit the oscillation of their distance to it."""
    place = numbers_of("at", at)
    if len(place) != 2:
        raise SearchError(f"at: {at!r} is of the wrong type: it must be two numbers, x,y")
    return target(
        points,
        place=(place[0], place[1]),
        scenario=given_scenario(scenario, drones=drones, duration=duration),
        dynamics=dynamics.value,
        seed=seed,
        out=picture,
        as_json=as_json,
    )


def target(
    points: Sequence[str],
    *,
    place: tuple[float, float],
    scenario: Scenario,
    dynamics: str,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> int:
    """Fly flocks around a target, print the fitted sines, and write a figure of them to `out`, .png.

    Raises:
        MoflockError: a flock cannot be flown, or the file cannot be written.
    """
    from rich.console import Console
    from rich.table import Table

    from moflock_mj.analysis.target_tracking import track_target
    from moflock_mj.parameters.points import load_point
    from optimize.reports.figures import save
    from optimize.reports.flight_figures import target_figure

    results = [
        track_target(load_point(point), target=place, scenario=scenario, dynamics=dynamics, seed=seed)
        for point in points
    ]
    if out is not None:
        save(lambda: target_figure(results, [f"Point {Path(point).stem}" for point in points]), out)
    figures = [
        {"point": point, **result.sine._asdict(), "residual": result.residual, "F_target": result.F_target}
        for point, result in zip(points, results, strict=True)
    ]
    if as_json:
        print(json.dumps({"target": list(place), "dynamics": dynamics, "seed": seed, "flocks": figures}, indent=1))
        return 0
    table = Table("point", "amplitude, m", "omega, rad/s", "offset, m", "residual, m", "F_target, rad/(s m)")
    for result_row in figures:
        columns = ("amplitude", "omega", "offset", "residual", "F_target")
        table.add_row(str(result_row["point"]), *(f"{result_row[name]:.4g}" for name in columns))
    Console().print(table)
    return 0
