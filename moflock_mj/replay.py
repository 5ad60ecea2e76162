"""What `moflock replay` does: read a log, or verify, resume or recover it; then show it in the forms asked for."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from moflock_mj.errors import LogError
from moflock_mj.log_reader import LoggedFlight, read_log
from moflock_mj.replay_text import print_logged_flight, print_recovery, print_verification
from moflock_mj.terminal import INTERRUPTED, flight_progress, print_flight, share_progress, stop_on_interrupt


@dataclasses.dataclass(frozen=True, kw_only=True)
class Look:
    """Forms in which a flight is to be seen; None for those that are not asked for.

    Attributes:
        viewer: whether to open MuJoCo's viewer.
        video, picture, html, csv, parquet: files to be written.
        layouts: a folder for the layouts of other viewers.
        camera: of the video: overview, chase or top.
        colour: what the drones' colour tells: speed or danger.
        fps: frames of the video a second.
        speed: simulated over shown time; chosen by the video itself if None.
        size: of the video, pixels.
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
        """The files that are asked for, by form."""
        forms = ("video", "picture", "html", "csv", "parquet")
        return {form: getattr(self, form) for form in forms if getattr(self, form) is not None}


def show_logs(logs: list[Path], look: Look, *, as_json: bool) -> int:
    """Read one log or two, and show them; print their figures.

    Raises:
        MoflockError: a log cannot be read, or a form not be made.
    """
    if len(logs) > 2:
        raise LogError(f"replay: {len(logs)} logs; it must be one, or two to be compared")
    flights = [read_log(path) for path in logs]
    for form, path in look.files.items():
        _make(form, flights, path, look)
    if look.layouts is not None:
        from moflock_mj.viewer_files import export_layouts  # noqa: PLC0415

        export_layouts(flights[0], look.layouts)
    for flight in flights:
        print_logged_flight(flight, as_json=as_json)
    if look.viewer:
        from moflock_mj.viewer import show  # noqa: PLC0415 - needs a display

        show(flights, colour=look.colour)
    return 0


def verify_log(path: Path, *, as_json: bool) -> int:
    """Fly a log's flight again and compare; status 1 if it differs.

    Raises:
        MoflockError: the log cannot be read, or its flight not be flown.
    """
    from moflock_mj.verify import verify  # noqa: PLC0415 - flies, so it loads the compiled loop

    logged = read_log(path)
    with flight_progress(logged.scenario.duration) as progress:
        verification = verify(logged, progress)
    print_verification(verification, as_json=as_json)
    return 0 if verification.difference is None else 1


def resume_log(
    path: Path, at: float, *, point: str | None, duration: float | None, log: Path | None, as_json: bool
) -> int:
    """Fly on from the middle of a log, perhaps with another point.

    Raises:
        MoflockError: the log cannot be read, or what is asked for not be flown.
    """
    from moflock_mj.points import load_point  # noqa: PLC0415
    from moflock_mj.verify import resume  # noqa: PLC0415

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
    """Write a finished log of what is intact in a broken one.

    Raises:
        LogError: nothing of a flight is left in it.
    """
    from moflock_mj.recover import recover  # noqa: PLC0415

    with share_progress("recovering") as progress:
        recovery = recover(broken, out, progress)
    print_recovery(recovery, as_json=as_json)
    return 0


def _make(form: str, flights: list[LoggedFlight], path: Path, look: Look) -> None:
    """Write one form of the flights; each form loads its own library."""
    if form == "picture":
        from moflock_mj.picture import draw_picture  # noqa: PLC0415

        draw_picture(flights, path)
    elif form == "html":
        from moflock_mj.page import write_page  # noqa: PLC0415

        write_page(flights, path, colour=look.colour)
    elif form == "video":
        from moflock_mj.video import render_video  # noqa: PLC0415

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
        from moflock_mj import export  # noqa: PLC0415

        if len(flights) > 1:
            raise LogError(f"{form}: {len(flights)} logs; it must be one")
        write = export.export_csv if form == "csv" else export.export_parquet
        write(flights[0], path)
