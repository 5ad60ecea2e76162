"""The command `moflock`: one verb per job. The only room that looks across the packages; it imports them lazily."""

from __future__ import annotations

import enum
import sys
from pathlib import Path
from typing import Annotated

import typer

from moflock_mj.errors import MoflockError

BAD_INPUT = 2
"""Exit status of a command that was asked for what cannot be done."""

app = typer.Typer(
    name="moflock",
    help="Fly flocks of quadrotors on MuJoCo physics before they fly for real.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


class Dynamics(enum.StrEnum):
    """What moves the drones."""

    RIGID_BODY = "rigid_body"
    POINT_MASS = "point_mass"


@app.callback()
def moflock() -> None:
    """Fly flocks of quadrotors on MuJoCo physics before they fly for real."""


@app.command("fly", epilog="Example: moflock fly --point A --drones 20 --duration 120 --log logs/a.mcap")
def fly_command(
    point: Annotated[str, typer.Option(help="A, B, model_optimum, or a .json file of parameters.")] = "model_optimum",
    dynamics: Annotated[Dynamics, typer.Option(help="What moves the drones.")] = Dynamics.RIGID_BODY,
    scenario: Annotated[Path | None, typer.Option(help="TOML file; what it leaves out is the paper's.")] = None,
    drones: Annotated[int | None, typer.Option(help="Number of drones.")] = None,
    duration: Annotated[float | None, typer.Option(help="Simulated seconds.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.")] = 1,
    step: Annotated[float | None, typer.Option(help="Integration step, s.")] = None,
    airframe: Annotated[str | None, typer.Option(help="x500, crazyflie.")] = None,
    log: Annotated[str | None, typer.Option(help="MCAP file, or none; by default a new file in logs/.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")] = False,
) -> int:
    """Fly a flock, log it, and judge it."""
    from moflock_mj import terminal  # noqa: PLC0415
    from moflock_mj.flight import fly  # noqa: PLC0415
    from moflock_mj.points import load_point  # noqa: PLC0415
    from moflock_mj.scenario import Scenario  # noqa: PLC0415

    given = {"drones": drones, "duration": duration, "step": step, "airframe": airframe}
    flown = Scenario.load(scenario) if scenario else Scenario()
    flown = flown.replace(**{name: value for name, value in given.items() if value is not None})
    path = terminal.log_path(log, point, dynamics, seed)
    with terminal.flight_progress(flown.duration) as progress, terminal.stop_on_interrupt() as interrupted:
        flight = fly(
            load_point(point),
            scenario=flown,
            dynamics=dynamics.value,
            seed=seed,
            log=path,
            keep_samples=False,
            progress=progress,
            stop=interrupted,
        )
    terminal.print_flight(flight, as_json=as_json)
    return 0 if flight.complete else terminal.INTERRUPTED


def main() -> None:
    """Run the command line; errors that are the user's to mend become one line on stderr."""
    try:
        status = app(sys.argv[1:] or ["--help"], standalone_mode=False)
    except MoflockError as problem:
        status = _refuse(str(problem))
    except typer.TyperException as problem:
        status = _refuse(problem.format_message())
    except (typer.Abort, KeyboardInterrupt):
        status = 130
    except BrokenPipeError:
        sys.stderr.close()
        status = 1
    sys.exit(status if isinstance(status, int) else 0)


def _refuse(message: str) -> int:
    print("moflock:", " ".join(message.split()), file=sys.stderr)
    return BAD_INPUT
