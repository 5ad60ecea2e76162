"""The command `moflock`: one verb per job. The only room that looks across the packages; it imports them lazily."""

from __future__ import annotations

import enum
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer

from moflock_mj.errors import MoflockError
from moflock_mj.gl import do_without_gl
from moflock_mj.options import AsJson, Count, Drones, Dynamics, KeyFile, ScenarioFile, given_scenario, refuse_options
from moflock_mj.preflight.commands import commands as preflight_commands
from optimize.commands import commands as search_commands
from optimize.validation_commands import commands as validation_commands

if TYPE_CHECKING:
    from moflock_mj.flight import Follower
    from moflock_mj.flock import Flock

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


@app.callback()
def moflock() -> None:
    """Fly flocks of quadrotors on MuJoCo physics before they fly for real."""


@app.command("fly", epilog="Example: moflock fly --point A --drones 20 --duration 120 --log logs/a.mcap")
def fly_command(
    point: Annotated[
        str, typer.Option(help="knee, fast, cohesive, steady, A, B, model_optimum, or a .json file of parameters.")
    ] = "steady",
    dynamics: Annotated[Dynamics, typer.Option(help="What moves the drones.")] = Dynamics.RIGID_BODY,
    scenario: ScenarioFile = None,
    drones: Drones = None,
    duration: Annotated[float | None, typer.Option(help="Simulated seconds.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.")] = 1,
    step: Annotated[float | None, typer.Option(help="Integration step, s.")] = None,
    airframe: Annotated[str | None, typer.Option(help="x500, crazyflie.")] = None,
    log: Annotated[str | None, typer.Option(help="MCAP file, or none; by default a new file in logs/.")] = None,
    live: Annotated[bool, typer.Option("--live", help="Show it to Foxglove or Lichtblick on this machine.")] = False,
    port: Annotated[int, typer.Option(help="Of --live.", min=0, max=65535)] = 8765,
    live_speed: Annotated[float, typer.Option(help="Of --live: simulated over real time.")] = 1.0,
    as_json: AsJson = False,
) -> int:
    """Fly a flock, log it, and judge it."""
    from moflock_mj import terminal  # noqa: PLC0415
    from moflock_mj.flight import fly  # noqa: PLC0415
    from moflock_mj.points import load_point  # noqa: PLC0415

    flown = given_scenario(scenario, drones=drones, duration=duration, step=step, airframe=airframe)
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
            followers=[_live_view(port, live_speed)] if live else [],
        )
    terminal.print_flight(flight, as_json=as_json)
    return 0 if flight.complete else terminal.INTERRUPTED


def _live_view(port: int, speed: float) -> Callable[[Flock], Follower]:
    """What makes the live view of a flock."""
    from moflock_mj.live import LiveServer  # noqa: PLC0415

    return lambda flock: LiveServer(flock, port=port, speed=speed)


class Camera(enum.StrEnum):
    """Where the video looks from."""

    OVERVIEW = "overview"
    CHASE = "chase"
    TOP = "top"


class Colour(enum.StrEnum):
    """What a drone's colour tells."""

    DANGER = "danger"
    SPEED = "speed"


_REPLAY_EXAMPLE = "Example: moflock replay logs/a.mcap --picture a.png --video a.mp4; moflock replay a.mcap --verify"


@app.command("replay", epilog=_REPLAY_EXAMPLE)
def replay_command(
    logs: Annotated[list[Path], typer.Argument(help="A log, or two to be compared.", metavar="LOG [LOG]")],
    verify: Annotated[bool, typer.Option("--verify", help="Fly it again and compare bit by bit.")] = False,
    resume: Annotated[
        float | None, typer.Option(help="Fly on from the stored state at or before this time, s.")
    ] = None,
    point: Annotated[str | None, typer.Option(help="Of --resume: fly on with this point.")] = None,
    duration: Annotated[float | None, typer.Option(help="Of --resume: seconds to fly on.")] = None,
    log: Annotated[Path | None, typer.Option(help="Of --resume and --recover: the MCAP file to be written.")] = None,
    recover: Annotated[bool, typer.Option("--recover", help="Save what is intact of a broken log.")] = False,
    viewer: Annotated[bool, typer.Option("--viewer", help="Play it in MuJoCo's viewer.")] = False,
    video: Annotated[Path | None, typer.Option(help="Write a video, .mp4.")] = None,
    picture: Annotated[Path | None, typer.Option(help="Write its curves and trajectories, .png, .svg or .pdf.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write a page with a 3D replay.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Write its samples as CSV.")] = None,
    parquet: Annotated[Path | None, typer.Option(help="Write its samples as Parquet.")] = None,
    layouts: Annotated[Path | None, typer.Option(help="Write layouts for Foxglove and Rerun into this folder.")] = None,
    camera: Annotated[Camera, typer.Option(help="Of the video.")] = Camera.OVERVIEW,
    colour: Annotated[Colour, typer.Option(help="What the drones' colour tells.")] = Colour.DANGER,
    fps: Annotated[int, typer.Option(help="Frames of the video a second.")] = 30,
    speed: Annotated[float | None, typer.Option(help="Of the video: simulated over shown time.")] = None,
    size: Annotated[str, typer.Option(help="Of the video, pixels.")] = "1280x720",
    as_json: AsJson = False,
) -> int:
    """See, check or recover a flight from its log."""
    from moflock_mj import replay  # noqa: PLC0415

    modes = {"--verify": verify, "--resume": resume is not None, "--recover": recover}
    chosen = [mode for mode, wanted in modes.items() if wanted]
    if len(chosen) > 1:
        raise MoflockError(f"replay: {' and '.join(chosen)} do not go together; it must be one")
    if chosen and len(logs) > 1:
        raise MoflockError(f"replay: {chosen[0]} of {len(logs)} logs; it must be one")
    if verify:
        return replay.verify_log(logs[0], as_json=as_json)
    if resume is not None:
        return replay.resume_log(logs[0], resume, point=point, duration=duration, log=log, as_json=as_json)
    if recover:
        return replay.recover_log(logs[0], log, as_json=as_json)
    look = replay.Look(
        viewer=viewer,
        video=video,
        picture=picture,
        html=html,
        csv=csv,
        parquet=parquet,
        layouts=layouts,
        camera=camera.value,
        colour=colour.value,
        fps=fps,
        speed=speed,
        size=_size(size),
    )
    return replay.show_logs(logs, look, as_json=as_json)


def _size(text: str) -> tuple[int, int]:
    """Width and height, pixels, of a text such as 1280x720."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise MoflockError(f"size: {text!r} is of the wrong type: it must be WIDTHxHEIGHT in pixels")
    return int(width), int(height)


app.add_typer(search_commands)
app.add_typer(validation_commands)
app.add_typer(preflight_commands)


class Autopilot(enum.StrEnum):
    """How simulated vehicles behave."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"


_FLEET_EXAMPLE = """Example: moflock fleet --vehicles 3 --autopilot px4 --fault drone=1,at=60,kind=gps_loss,for=10

Vehicle i listens on UDP port base-port + i and answers whoever speaks to it. MAVSDK: udpout://127.0.0.1:14600 for the
first vehicle. MAVProxy: mavproxy.py --master udpout:127.0.0.1:14600. With --to 127.0.0.1:14540 all vehicles speak
first, and a client waits for them: MAVSDK udpin://127.0.0.1:14540, MAVProxy --master udpin:127.0.0.1:14540.

Faults are drone (from 0, or all), kind, at (s), for (s) and value; kinds: silent, gps_loss, low_battery (value: share
of charge), link_loss (share of packets), delay (s), duplicate_id (system id), motor_failure (rotor 0 to 3), pilot.

With --physics-for, the bodies are flown by real autopilots instead: programs that --autopilot-command starts, or that
you start. They are waited for at 127.0.0.1, ArduPilot's instance i at UDP port 9002 + 10 i, PX4's at TCP port 4560 + i:

  moflock fleet --physics-for ardupilot --vehicles 3 --autopilot-command "arducopter --model JSON:127.0.0.1
  -I{instance} --sysid {sysid} --home {home} --speedup {speed} --defaults {here}/copter.parm"

  moflock fleet --physics-for px4 --autopilot-command "env PX4_SYS_AUTOSTART=10016 px4 -i {instance} -d /px4/etc"

Links are signed if --key-file or the environment variable MOFLOCK_SIGNING_KEY gives a key: 64 hexadecimal digits, or a
pass phrase."""


_NOT_OF_REAL_AUTOPILOTS = ("autopilot", "base_port", "bind", "to", "boot", "fault", "faults", "key_file")
"""Options of fleet that are about simulated autopilots."""


@app.command("fleet", epilog=_FLEET_EXAMPLE)
def fleet_command(
    context: typer.Context,
    vehicles: Annotated[int | None, typer.Option(help="Number; by default the scenario's drones, or 1.")] = None,
    autopilot: Annotated[Autopilot, typer.Option(help="How they behave.")] = Autopilot.ARDUPILOT,
    base_port: Annotated[int, typer.Option(help="UDP port of the first vehicle; 0: any that are free.")] = 14600,
    bind: Annotated[str, typer.Option(help="Address of this machine at which they listen.")] = "127.0.0.1",
    to: Annotated[str | None, typer.Option(help="HOST:PORT to which they send unasked.")] = None,
    speed: Annotated[float, typer.Option(help="Simulated over real time.")] = 1.0,
    spacing: Annotated[float, typer.Option(help="Between neighbours on the ground, m.")] = 12.0,
    boot: Annotated[float, typer.Option(help="Simulated seconds until a position can be used.")] = 8.0,
    scenario: Annotated[Path | None, typer.Option(help="TOML file: airframe, response, noise.")] = None,
    airframe: Annotated[str | None, typer.Option(help="x500, crazyflie.")] = None,
    fault: Annotated[list[str] | None, typer.Option(help="A fault; may be given several times.")] = None,
    faults: Annotated[Path | None, typer.Option(help="TOML file of faults, a table [[fault]] each.")] = None,
    key_file: KeyFile = None,
    physics_for: Annotated[Autopilot | None, typer.Option(help="Be the physics of real autopilots.")] = None,
    autopilot_command: Annotated[
        str | None,
        typer.Option(help="Starts one of them: {instance}, {sysid}, {port}, {home}, {speed}, {here} are filled in."),
    ] = None,
    autopilot_folder: Annotated[
        Path | None, typer.Option(help="Of their working directories and output; by default a new one in logs/.")
    ] = None,
    physics_port: Annotated[int | None, typer.Option(help="Of the first; by default the autopilot's own.")] = None,
    duration: Annotated[float | None, typer.Option(help="Simulated seconds; by default until Ctrl-C.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of all random numbers.")] = 1,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print a JSON object at the start and one at the end.")
    ] = False,
) -> int:
    """Simulated vehicles that speak MAVLink, in real time: a rehearsal for those who command real ones."""
    from moflock_mj.mavlink import fleet_terminal  # noqa: PLC0415
    from moflock_mj.mavlink.fleet import FleetPlan  # noqa: PLC0415
    from moflock_mj.mavlink.fleet_faults import Fault, load_faults  # noqa: PLC0415
    from moflock_mj.mavlink.signing import find_key  # noqa: PLC0415

    flown = given_scenario(scenario, airframe=airframe)
    number = vehicles if vehicles is not None else flown.drones if scenario else 1
    if physics_for is not None:
        refuse_options(context, _NOT_OF_REAL_AUTOPILOTS, "--physics-for")
        from moflock_mj.autopilot.lockstep import PhysicsPlan  # noqa: PLC0415
        from moflock_mj.autopilot.terminal import run_physics  # noqa: PLC0415

        physics = PhysicsPlan(
            autopilot=physics_for.value,
            vehicles=number,
            port=physics_port,
            speed=speed,
            spacing=spacing,
            scenario=flown,
            seed=seed,
        )
        return run_physics(physics, autopilot_command, autopilot_folder, duration, as_json=as_json)
    refuse_options(context, ("autopilot_command", "autopilot_folder", "physics_port"), "a fleet without --physics-for")
    plan = FleetPlan(
        vehicles=number,
        autopilot=autopilot.value,
        base_port=base_port,
        bind=bind,
        to=fleet_terminal.address(to) if to else None,
        speed=speed,
        spacing=spacing,
        boot=boot,
        scenario=flown,
        faults=[*(load_faults(faults) if faults else ()), *map(Fault.from_text, fault or ())],
        seed=seed,
    )
    return fleet_terminal.run_fleet(plan, find_key(key_file), duration, as_json=as_json)


class Finish(enum.StrEnum):
    """How a deployment ends."""

    HOLD = "hold"
    RETURN = "return"
    LAND = "land"


_DEPLOY_EXAMPLE = """Example: moflock deploy steady --vehicles udp:127.0.0.1:14600-14609 --duration 60 --rehearse

Vehicles are KIND:HOST:PORT or KIND:HOST:PORT-LAST, several separated by commas. udp (udpout): we speak first, to
vehicles that listen, such as those of moflock fleet. udpin: we listen; PX4 speaks to port 14540 + i, ArduPilot to
14550. tcp: ArduPilot's simulators at 5760, 5770...

Ctrl-C (or SIGTERM) once: all hold; twice: all land; three times: they are left to their own failsafes.

Watchdogs are NAME=LIMIT:ACTION, such as battery=0.3:return, with actions slow, hold, return, land. stale (s, age of a
position), lost (s of silence), fence (m outside of the arena where it would stop), separation (m), battery (share of
charge); keep_off (m, that the flock keeps off who has left it) has no action. Who is in a mode that nobody here has
asked for is flown by somebody else, and never commanded again."""


@app.command("deploy", epilog=_DEPLOY_EXAMPLE)
def deploy_command(
    point: Annotated[str, typer.Argument(help="knee, fast, cohesive, steady, A, B, model_optimum, or a .json file.")],
    vehicles: Annotated[str, typer.Option(help="Where they are, such as udp:127.0.0.1:14600-14609.")],
    scenario: ScenarioFile = None,
    duration: Annotated[float | None, typer.Option(help="Seconds in the flock; by default the scenario's.")] = None,
    count: Count = None,
    autopilot: Annotated[Autopilot | None, typer.Option(help="What all must be.")] = None,
    finish: Annotated[Finish, typer.Option(help="How it ends.")] = Finish.LAND,
    origin: Annotated[
        str | None,
        typer.Option(help="LATITUDE,LONGITUDE of the arena's middle, degrees; by default the mean of the homes."),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help="Of moflock preflight; by default the newest fitting one in logs/.")
    ] = None,
    rehearse: Annotated[bool, typer.Option("--rehearse", help="No report: simulated vehicles alone.")] = False,
    watchdog: Annotated[list[str] | None, typer.Option(help="NAME=LIMIT:ACTION; may be given several times.")] = None,
    interval: Annotated[float, typer.Option(help="Seconds between two take-offs.", min=0.0, max=60.0)] = 1.0,
    timeout: Annotated[float, typer.Option(help="Seconds to wait for the vehicles.", min=0.0, max=600.0)] = 10.0,
    key_file: KeyFile = None,
    log: Annotated[str | None, typer.Option(help="MCAP file, or none; by default a new file in logs/.")] = None,
    as_json: AsJson = False,
) -> int:
    """Fly real or simulated vehicles by a point that has passed its pre-flight checks."""
    from moflock_mj.deploy.verb import deploy_vehicles  # noqa: PLC0415

    return deploy_vehicles(
        point,
        vehicles,
        given_scenario(scenario, duration=duration),
        count=count,
        autopilot=autopilot.value if autopilot else None,
        finish=finish.value,
        origin=origin,
        report=report,
        rehearse=rehearse,
        watchdogs=watchdog or (),
        interval=interval,
        timeout=timeout,
        key_file=key_file,
        log=log,
        as_json=as_json,
    )


def main() -> None:
    """Run the command line; errors that are the user's to mend become one line on stderr."""
    signal.signal(signal.SIGTERM, _leave)
    do_without_gl()
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


def _leave(signal_number: int, frame: FrameType | None) -> None:  # noqa: ARG001
    """End the command as an exception would, so that it cleans up; a second wish does not disturb it at that."""
    signal.signal(signal_number, signal.SIG_IGN)
    sys.exit(128 + signal_number)


def _refuse(message: str) -> int:
    print("moflock:", " ".join(message.split()), file=sys.stderr)
    return BAD_INPUT
