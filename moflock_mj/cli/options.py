"""Options that several verbs of the command `moflock` have, and what they ask for."""

from __future__ import annotations

import enum
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moflock_mj.errors import MoflockError

if TYPE_CHECKING:
    from moflock_mj.scenario.scenario import Scenario


BAD_INPUT = 2
"""Exit status of a command that was asked for what cannot be done."""

INTERRUPTED = 130
"""Exit status of a command that Ctrl-C ended, as a shell gives it."""


class Dynamics(enum.StrEnum):
    """What moves the drones."""

    RIGID_BODY = "rigid_body"
    POINT_MASS = "point_mass"


ScenarioFile = Annotated[Path | None, typer.Option("--scenario", help="TOML file; what it leaves out is the paper's.")]


Drones = Annotated[int | None, typer.Option(help="Number of drones.")]


AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")]


KeyFile = Annotated[Path | None, typer.Option(help="Of the links' signatures; only you may read it.")]


Count = Annotated[int | None, typer.Option(help="Vehicles; by default one on each link.", min=1)]


def given_scenario(path: Path | None, **changes: Any) -> Scenario:
    """The scenario of a file, or the paper's, with what else was given in its place.

    Args:
        path: TOML file, or None.
        changes: fields by name; None for one that was not given.

    Raises:
        ScenarioError: the file cannot be read, or a value is wrong.
    """
    from moflock_mj.scenario.scenario import Scenario

    scenario = Scenario.load(path) if path else Scenario()
    return scenario.replace(**{name: value for name, value in changes.items() if value is not None})


def refuse_options(context: typer.Context, names: Iterable[str], of: str) -> None:
    """Refuse options that were given and would do nothing.

    Args:
        context: of the command.
        names: of its parameters.
        of: what they do not go with.

    Raises:
        MoflockError: one of them was given.
    """
    for name in names:
        source = context.get_parameter_source(name)
        if source is not None and source.name != "DEFAULT":
            raise MoflockError(f"--{name.replace('_', '-')}: {of} has no use for it")


class Autopilot(enum.StrEnum):
    """How simulated vehicles behave."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"
