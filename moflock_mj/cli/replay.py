"""The command `moflock replay`: read, verify, resume or recover a log, and export or show its flight."""

from __future__ import annotations

import dataclasses
import enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moflock_mj.cli.options import (
    AsJson,
)
from moflock_mj.errors import LogError, MoflockError

if TYPE_CHECKING:
    from moflock_mj.log.reader import LoggedFlight

commands = typer.Typer()


class Camera(enum.StrEnum):
    """Camera of the video."""

    OVERVIEW = "overview"
    CHASE = "chase"
    TOP = "top"


class Colour(enum.StrEnum):
    """Quantity shown by a drone's colour."""

    DANGER = "danger"
    SPEED = "speed"


_REPLAY_EXAMPLE = "Example: moflock replay logs/a.mcap --picture a.png --video a.mp4; moflock replay a.mcap --verify"


@commands.command("replay", epilog=_REPLAY_EXAMPLE)
def replay_command(
    logs: Annotated[list[Path], typer.Argument(help="One log, or two logs to compare.", metavar="LOG [LOG]")],
    verify: Annotated[bool, typer.Option("--verify", help="Repeat the flight and compare it bit by bit.")] = False,
    resume: Annotated[
        float | None, typer.Option(help="Continue the flight from the stored state at or before this time, s.")
    ] = None,
    point: Annotated[str | None, typer.Option(help="Point for --resume; by default the log's.")] = None,
    duration: Annotated[
        float | None, typer.Option(help="Simulated time for --resume, s; by default to the end of the flight.")
    ] = None,
    log: Annotated[Path | None, typer.Option(help="MCAP file that --resume or --recover writes.")] = None,
    recover: Annotated[
        bool, typer.Option("--recover", help="Copy the intact part of a damaged log to a new log.")
    ] = False,
    viewer: Annotated[bool, typer.Option("--viewer", help="Play the flight in MuJoCo's viewer.")] = False,
    video: Annotated[Path | None, typer.Option(help="Write a video, .mp4.")] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Write a figure of curves and trajectories, .png, .svg or .pdf.")
    ] = None,
    html: Annotated[Path | None, typer.Option(help="Write an HTML page with a 3D replay.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Write the samples as CSV.")] = None,
    parquet: Annotated[Path | None, typer.Option(help="Write the samples as Parquet.")] = None,
    layouts: Annotated[Path | None, typer.Option(help="Write layouts for Foxglove and Rerun to this folder.")] = None,
    camera: Annotated[Camera, typer.Option(help="Camera of the video.")] = Camera.OVERVIEW,
    colour: Annotated[Colour, typer.Option(help="Quantity shown by the drones' colour.")] = Colour.DANGER,
    fps: Annotated[int, typer.Option(help="Frame rate of the video, Hz.")] = 30,
    speed: Annotated[
        float | None, typer.Option(help="Speed of the video: simulated seconds per second of video.")
    ] = None,
    size: Annotated[str, typer.Option(help="Size of the video, WIDTHxHEIGHT in pixels.")] = "1280x720",
    as_json: AsJson = False,
) -> int:
    """Show, verify, resume or recover a logged flight."""
    modes = {"--verify": verify, "--resume": resume is not None, "--recover": recover}
    chosen = [mode for mode, is_given in modes.items() if is_given]
    if len(chosen) > 1:
        raise MoflockError(f"replay: {' and '.join(chosen)} exclude each other; it must be one")
    if chosen and len(logs) > 1:
        raise MoflockError(f"replay: {chosen[0]} of {len(logs)} logs; it must be one")
    if verify:
        return verify_log(logs[0], as_json=as_json)
    if resume is not None:
        return resume_log(logs[0], resume, point=point, duration=duration, log=log, as_json=as_json)
    if recover:
        return recover_log(logs[0], log, as_json=as_json)
    look = RenderOptions(
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
    return show_logs(logs, look, as_json=as_json)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RenderOptions:
    """Outputs to make of a logged flight; None for an output that was not requested.

    Attributes:
        viewer: whether to open MuJoCo's viewer.
        video, picture, html, csv, parquet: files to write.
        layouts: folder for the layouts of other viewers.
        camera: camera of the video: overview, chase or top.
        colour: quantity shown by the drones' colour: speed or danger.
        fps: frame rate of the video, Hz.
        speed: simulated seconds per second of video; None for the default of the video.
        size: width and height of the video, pixels.
    """

    viewer: bool = False
    video: Path | None = None
    picture: Path | None = None
    html: Path | None = None
    csv: Path | None = None
    parquet: Path | None = None
    layouts: Path | None = None
    camera: str = "overview"
    colour: str = "danger"
    fps: int = 30
    speed: float | None = None
    size: tuple[int, int] = (1280, 720)

    @property
    def files(self) -> dict[str, Path]:
        """Files to write, by format."""
        forms = ("video", "picture", "html", "csv", "parquet")
        return {form: getattr(self, form) for form in forms if getattr(self, form) is not None}


def show_logs(logs: list[Path], look: RenderOptions, *, as_json: bool) -> int:
    """Read one or two logs, make the outputs, and print the results.

    Raises:
        MoflockError: a log cannot be read, or an output cannot be made.
    """
    from moflock_mj.cli.replay_output import print_logged_flight
    from moflock_mj.log.reader import read_log

    if len(logs) > 2:
        raise LogError(f"replay: {len(logs)} logs; it must be one, or two to compare")
    flights = [read_log(path) for path in logs]
    for form, path in look.files.items():
        _make(form, flights, path, look)
    if look.layouts is not None:
        from moflock_mj.visualization.viewer_layouts import export_layouts

        export_layouts(flights[0], look.layouts)
    for flight in flights:
        print_logged_flight(flight, as_json=as_json)
    if look.viewer:
        from moflock_mj.rendering.interactive_viewer import show

        show(flights, colour=look.colour)
    return 0


def verify_log(path: Path, *, as_json: bool) -> int:
    """Repeat a log's flight and compare it with the log; returns status 1 if they differ.

    Raises:
        MoflockError: the log cannot be read, or its flight cannot be repeated.
    """
    from moflock_mj.analysis.verification import verify
    from moflock_mj.cli.console import flight_progress
    from moflock_mj.cli.replay_output import print_verification
    from moflock_mj.log.reader import read_log

    logged = read_log(path)
    with flight_progress(logged.scenario.duration) as progress:
        verification = verify(logged, progress)
    print_verification(verification, as_json=as_json)
    return 0 if verification.difference is None else 1


def resume_log(
    path: Path, at: float, *, point: str | None, duration: float | None, log: Path | None, as_json: bool
) -> int:
    """Continue a logged flight from a stored state, with the same or another point.

    Raises:
        MoflockError: the log cannot be read, or the flight cannot be continued.
    """
    from moflock_mj.analysis.verification import resume
    from moflock_mj.cli.console import flight_progress, print_flight, stop_on_interrupt
    from moflock_mj.cli.options import INTERRUPTED
    from moflock_mj.log.reader import read_log
    from moflock_mj.parameters.points import load_point

    params = load_point(point) if point else None
    logged = read_log(path)
    with flight_progress(logged.scenario.duration) as progress, stop_on_interrupt() as interrupted:
        flight = resume(
            logged,
            at,
            params=params,
            duration=duration,
            log=log,
            keep_samples=False,
            progress=progress,
            stop=interrupted,
        )
    print_flight(flight, as_json=as_json)
    return 0 if flight.complete else INTERRUPTED


def recover_log(broken: Path, out: Path | None, *, as_json: bool) -> int:
    """Write a complete log from the intact part of a damaged one.

    Raises:
        LogError: the log has no intact part of a flight.
    """
    from moflock_mj.cli.console import share_progress
    from moflock_mj.cli.replay_output import print_recovery
    from moflock_mj.log.recovery import recover

    with share_progress("recovering") as progress:
        recovery = recover(broken, out, progress)
    print_recovery(recovery, as_json=as_json)
    return 0


def _make(form: str, flights: list[LoggedFlight], path: Path, look: RenderOptions) -> None:
    """Write one output of the flights; each format loads its own library."""
    from moflock_mj.cli.console import share_progress

    if form == "picture":
        from moflock_mj.visualization.flight_figure import save_flight_figure

        save_flight_figure(flights, path)
    elif form == "html":
        from moflock_mj.visualization.html_page import write_page

        write_page(flights, path, colour=look.colour)
    elif form == "video":
        from moflock_mj.rendering.video import render_video

        with share_progress("rendering") as progress:
            render_video(
                flights,
                path,
                camera=look.camera,
                colour=look.colour,
                fps=look.fps,
                speed=look.speed,
                size=look.size,
                progress=progress,
            )
    else:
        from moflock_mj.log import table_export

        if len(flights) > 1:
            raise LogError(f"{form}: {len(flights)} logs; it must be one")
        write = table_export.export_csv if form == "csv" else table_export.export_parquet
        write(flights[0], path)


def _size(text: str) -> tuple[int, int]:
    """Parse width and height, pixels, from a text such as 1280x720."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise MoflockError(f"size: {text!r} is of the wrong type: it must be WIDTHxHEIGHT in pixels")
    return int(width), int(height)
