"""The command `moflock fly`: fly a flock, log it, and score it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import typer

from moflock_mj.cli.options import (
    Airframe,
    AsJson,
    Drones,
    Dynamics,
    ScenarioFile,
    given_scenario,
    point_names,
)

if TYPE_CHECKING:
    from moflock_mj.simulation.results import FlightObserver
    from moflock_mj.simulation.simulation import Simulation

commands = typer.Typer()


@commands.command("fly", epilog="Example: moflock fly --point A --drones 20 --duration 120 --log logs/a.mcap")
def fly_command(
    point: Annotated[
        str, typer.Option(help=f"Named point ({', '.join(point_names())}) or .json file of parameters.")
    ] = "steady",
    dynamics: Annotated[Dynamics, typer.Option(help="Model of the drones' motion.")] = Dynamics.RIGID_BODY,
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Annotated[float | None, typer.Option(help="Simulated time, s.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.")] = 1,
    step: Annotated[float | None, typer.Option(help="Integration step, s.")] = None,
    airframe: Airframe = None,
    log: Annotated[str | None, typer.Option(help="MCAP file, or none; by default a new file in logs/.")] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Serve the flight live to Foxglove or Lichtblick on this machine.")
    ] = False,
    port: Annotated[int, typer.Option(help="Port of the live server.", min=0, max=65535)] = 8765,
    live_speed: Annotated[float, typer.Option(help="Speed of --live: simulated seconds per real second.")] = 1.0,
    as_json: AsJson = False,
) -> int:
    """Fly a flock in simulation, log the flight, and score it."""
    from moflock_mj.cli import console
    from moflock_mj.cli.options import INTERRUPTED
    from moflock_mj.flight import fly
    from moflock_mj.parameters.points import load_point

    flown = given_scenario(scenario, drones=drones, duration=duration, step=step, airframe=airframe)
    path = console.log_path(log, point, dynamics, seed)
    with console.flight_progress(flown.duration) as progress, console.stop_on_interrupt() as interrupted:
        flight = fly(
            load_point(point),
            scenario=flown,
            dynamics=dynamics.value,
            seed=seed,
            log=path,
            keep_samples=False,
            progress=progress,
            stop=interrupted,
            observers=[_live_view(port, live_speed)] if live else [],
        )
    console.print_flight(flight, as_json=as_json)
    return 0 if flight.complete else INTERRUPTED


def _live_view(port: int, speed: float) -> Callable[[Simulation], FlightObserver]:
    """Factory of the live server of a simulation."""
    from moflock_mj.visualization.live_server import LiveServer

    return lambda simulation: LiveServer(simulation, port=port, speed=speed)
