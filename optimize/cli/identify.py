"""The command `moflock identify`: fit the point mass to an airframe."""

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
    airframe: Annotated[str, typer.Argument(help="x500, crazyflie.")],
    scenario: ScenarioFile = None,
    out: Annotated[Path | None, typer.Option(help="Scenario with the calibrated point mass, .toml.")] = None,
    as_json: AsJson = False,
) -> int:
    """Fit the point mass's tau, a_max and delay to an airframe with its controllers."""
    return identify_airframe(given_scenario(scenario, airframe=airframe), out=out, as_json=as_json)


def identify_airframe(scenario: Scenario, *, out: Path | None, as_json: bool) -> int:
    """Identify the scenario's airframe, print what was found; `out`: the scenario with the calibrated point mass.

    Raises:
        MoflockError: the airframe is unknown or too weak, or the file cannot be written.
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
