"""Options shared by several commands of `moflock`, and the values that they name."""

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
"""Exit status of a command whose input is invalid."""

INTERRUPTED = 130
"""Exit status of a command that Ctrl-C ended, as in a shell."""

_PACKAGE = Path(__file__).resolve().parents[1]


def point_names() -> list[str]:
    """Names of the named points: the file stems in `parameters/named_points`.

    The same as `moflock_mj.parameters.points.point_names`, which imports NumPy.
    """
    stems = (path.stem for path in (_PACKAGE / "parameters" / "named_points").glob("*.json"))
    return sorted(stems, key=lambda name: (name.lower() != name, name))


def airframe_names() -> list[str]:
    """Names of the airframes: the file stems in `models`, without the ground.

    The same as `moflock_mj.dynamics.airframe_models.airframe_names`, which imports MuJoCo.
    """
    installed = _PACKAGE / "models"
    folder = installed if installed.is_dir() else _PACKAGE.parent / "models"
    return sorted(path.stem for path in folder.glob("*.xml") if path.stem != "ground")


class Dynamics(enum.StrEnum):
    """Model of the drones' motion."""

    RIGID_BODY = "rigid_body"
    POINT_MASS = "point_mass"


ScenarioFile = Annotated[
    Path | None, typer.Option("--scenario", help="TOML file; absent fields have the paper's values.")
]


Drones = Annotated[int | None, typer.Option(help="Number of drones.")]


Airframe = Annotated[str | None, typer.Option(help=f"Airframe: {', '.join(airframe_names())}.")]


PointArgument = Annotated[
    str, typer.Argument(metavar="POINT", help="Named point (moflock fly --help lists them) or .json file.")
]


AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")]


KeyFile = Annotated[
    Path | None, typer.Option(help="File with the MAVLink signing key; must be readable by its owner only.")
]


Count = Annotated[int | None, typer.Option(help="Number of vehicles; by default one on each link.", min=1)]


def given_scenario(path: Path | None, **changes: Any) -> Scenario:
    """Load a scenario, or take the paper's, and replace the fields that were given.

    Args:
        path: TOML file; None for the paper's scenario.
        changes: fields by name; None for a field that was not given.

    Raises:
        ScenarioError: the file cannot be read, or a value is invalid.
    """
    from moflock_mj.scenario.scenario import Scenario

    scenario = Scenario.load(path) if path else Scenario()
    return scenario.replace(**{name: value for name, value in changes.items() if value is not None})


def refuse_options(context: typer.Context, names: Iterable[str], mode: str) -> None:
    """Refuse options that were given but have no effect in this mode of the command.

    Args:
        context: context of the command.
        names: names of the parameters without effect.
        mode: mode of the command, for the message.

    Raises:
        MoflockError: one of them was given.
    """
    for name in names:
        source = context.get_parameter_source(name)
        if source is not None and source.name != "DEFAULT":
            raise MoflockError(f"--{name.replace('_', '-')}: it has no effect with {mode}")


class Autopilot(enum.StrEnum):
    """Autopilot of a vehicle."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"
