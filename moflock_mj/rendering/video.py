"""Video of one flight, or two in one arena, rendered off-screen by several processes."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Generator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moflock_mj.errors import RenderError
from moflock_mj.files import new_file
from moflock_mj.rendering.cameras import CAMERAS
from moflock_mj.rendering.gl import environment_with, find_gl
from moflock_mj.rendering.render_worker import RenderJob
from moflock_mj.simulation.results import AnyFlight
from moflock_mj.visualization.captions import flight_names
from moflock_mj.visualization.playback import Playback, playback_of

SMALLEST = 480, 270
"""Minimum width and height, pixels, at which captions are legible and do not overlap."""

_LARGEST = 8192
"""Maximum width and height, pixels."""

_WATCHABLE = 60.0
"""Maximum duration of a video at the default speed, s."""


def render_video(
    flights: Sequence[AnyFlight],
    out: str | os.PathLike[str],
    *,
    camera: str = "overview",
    colour: str = "danger",
    fps: int = 30,
    speed: float | None = None,
    size: tuple[int, int] = (1280, 720),
    processes: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Render one flight, or two to compare, as MPEG-4 with H.264.

    Args:
        flights: one or two flights with samples, in one arena; each of two has its own colour.
        out: file to write, .mp4.
        camera: overview, chase or top.
        colour: quantity shown by the drones' colour: speed or danger.
        fps: frame rate, Hz.
        speed: simulated seconds per second of video; None for real time, or faster for at most a minute of video.
        size: width and height, pixels.
        processes: number of rendering processes; None for one per processor.
        progress: callback that receives the completed share, from 0 to 1.

    Raises:
        RenderError: a setting is out of bounds, there is no GL or no codec, or the file cannot be written.
    """
    _check(camera, fps, speed, size)
    if Path(out).suffix != ".mp4":
        raise RenderError(f"{os.fspath(out)}: it must end in .mp4")
    playback = playback_of(flights, colour=colour, names=flight_names(flights))
    seconds = playback.end - playback.begin
    speed = speed or max(1.0, seconds / _WATCHABLE)
    times = playback.begin + np.arange(max(round(seconds / speed * fps), 1)) * speed / fps
    processes = processes or len(os.sched_getaffinity(0))
    job = RenderJob(camera, speed, size, times.tolist(), min(processes, len(times)))
    with (
        new_file(out) as place,
        _Encoder(place, fps, size) as encoder,
        contextlib.closing(_frames(playback, job)) as frames,
    ):
        for number, frame in enumerate(frames, start=1):
            encoder.add(frame)
            if progress:
                progress(number / len(times))


def _check(camera: str, fps: int, speed: float | None, size: tuple[int, int]) -> None:
    if camera not in CAMERAS:
        raise RenderError(f"camera: {camera!r} is unknown: it must be one of {', '.join(CAMERAS)}")
    if not 1 <= fps <= 240:
        raise RenderError(f"fps: {fps} is out of bounds: it must be at least 1 and at most 240")
    if speed is not None and not 0.01 <= speed <= 1e4:
        raise RenderError(f"speed: {speed:g} is out of bounds: it must be at least 0.01 and at most 10000")
    (width, height), (least_wide, least_high) = size, SMALLEST
    if width % 2 or height % 2 or not (least_wide <= width <= _LARGEST and least_high <= height <= _LARGEST):
        raise RenderError(
            f"size: {width}x{height} is out of bounds: it must be even numbers, at least {least_wide}x{least_high} "
            f"and at most {_LARGEST}x{_LARGEST}"
        )


def _frames(playback: Playback, job: RenderJob) -> Generator[NDArray[np.uint8], None, None]:
    """Yield the frames in order, (height, width, 3); a process waits until its latest frame has been read."""
    workers: list[subprocess.Popen[bytes]] = []
    with tempfile.TemporaryDirectory(prefix="moflock-video-") as name:
        folder, backend = Path(name), find_gl()
        playback.save(folder)
        job.save(folder)
        try:
            for number in range(job.processes):
                workers.append(_start_worker(folder, number, backend))
            for number in range(len(job.times)):
                turn = number % job.processes
                yield _read_frame(workers[turn], job.size, _stderr_file(folder, turn))
        finally:
            for process in workers:
                process.kill()
                process.communicate()


def _stderr_file(folder: Path, number: int) -> Path:
    """File with the stderr of a rendering process."""
    return folder / f"{number}.txt"


def _start_worker(folder: Path, number: int, backend: str) -> subprocess.Popen[bytes]:
    """Start a rendering process with this process's import path, in its own session so that Ctrl-C does not end it."""
    path = os.pathsep.join(str(Path(place).absolute()) for place in sys.path)
    with _stderr_file(folder, number).open("wb") as stderr:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "moflock_mj.rendering.render_worker", str(folder), str(number)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=stderr,
            env={**environment_with(backend), "PYTHONPATH": path},
            start_new_session=True,
        )


def _read_frame(process: subprocess.Popen[bytes], size: tuple[int, int], stderr: Path) -> NDArray[np.uint8]:
    """Read the next frame of a process, (height, width, 3).

    Raises:
        RenderError: the process has ended; the message includes the last line of its stderr.
    """
    width, height = size
    frame = process.stdout.read(3 * width * height) if process.stdout else b""
    if len(frame) < 3 * width * height:
        reason = stderr.read_text(errors="replace").strip().rpartition("\n")[2]
        raise RenderError(
            f"video: a rendering process ended with status {process.wait()}: {reason or 'no reason given'}"
        )
    return np.frombuffer(frame, np.uint8).reshape(height, width, 3)


class _Encoder:
    """Encoder of an H.264 file."""

    def __init__(self, path: Path, fps: int, size: tuple[int, int]) -> None:
        try:
            import av  # noqa: PLC0415 - an extra
            import PIL.Image  # noqa: F401, PLC0415 - part of the same extra, for captions
        except ImportError as problem:
            name = str(problem.name).partition(".")[0]
            raise RenderError(f"video: {name} is not installed; pip install 'moflock-mj[video]'") from None
        self._av = av
        self._container = av.open(str(path), "w", format="mp4")
        try:
            self._stream = self._container.add_stream("libx264", rate=fps)
        except (ValueError, av.FFmpegError):
            self._container.close()
            raise RenderError("video: this PyAV has no codec libx264; pip install 'moflock-mj[video]'") from None
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = "yuv420p"
        self._stream.options = {"crf": "20", "preset": "veryfast"}

    def add(self, frame: NDArray[np.uint8]) -> None:
        """Add the next frame, (height, width, 3)."""
        self._container.mux(self._stream.encode(self._av.VideoFrame.from_ndarray(frame, format="rgb24")))

    def __enter__(self) -> _Encoder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._container.mux(self._stream.encode())
        self._container.close()
