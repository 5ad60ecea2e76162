"""Command `moflock identify`: fit of the point-mass model to an airframe."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moflock_mj.cli.options import AsJson, ScenarioFile, given_scenario

if TYPE_CHECKING:
    from moflock_mj.scenario.scenario import Scenario

commands = typer.Typer()


@commands.command("identify", epilog="Example: moflock identify x500 --out calibrated.toml")
def identify_command(
    airframe: Annotated[str, typer.Argument(help="Name of the airframe: x500 or crazyflie.")],
    scenario: ScenarioFile = None,
    out: Annotated[
        Path | None, typer.Option(help="Output file for the scenario with the calibrated point mass, .toml.")
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Fit tau, a_max and delay of the point-mass model to an airframe with its controllers."""
    return identify_airframe(given_scenario(scenario, airframe=airframe), out=out, as_json=as_json)


def identify_airframe(scenario: Scenario, *, out: Path | None, as_json: bool) -> int:
    """Identify the scenario's airframe, print the result, and write the calibrated scenario to `out`.

    Raises:
        MoflockError: the airframe is unknown or has too little thrust, or the file cannot be written.
    """
    from rich.console import Console

    from moflock_mj.analysis.identification import identify
    from moflock_mj.files import new_file
    from optimize.reports import identification_tables
    from optimize.reports.tables import rich_table
    from optimize.reports.validation_page import dumps

    found = identify(scenario)
    if out is not None:
        with new_file(out) as place:
            place.write_text(scenario.replace(point_mass=found.response).to_toml(), encoding="utf-8")
    if as_json:
        print(dumps(identification_tables.to_json(found)), end="")
        return 0
    console = Console()
    for words in identification_tables.tables(found):
        console.print(rich_table(words))
    if out is not None:
        console.print(f"calibrated scenario: {out}", highlight=False, soft_wrap=True)
    return 0
