"""A flight, or two in one arena, as a video: rendered without a screen, by several processes, encoded as it comes."""

from __future__ import annotations

import collections
import contextlib
import multiprocessing
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moflock_mj.cameras import CAMERAS
from moflock_mj.captions import flight_names
from moflock_mj.errors import RenderError
from moflock_mj.flight import AnyFlight
from moflock_mj.new_file import new_file
from moflock_mj.playback import Playback, playback_of

_WATCHABLE = 60.0
"""Longest video, s, unless the user chooses the speed."""

_AHEAD = 4
"""Frames that each process may be ahead of the encoder."""

_PROBE = "import mujoco; mujoco.GLContext(16, 16).make_current()"


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
    """Render one flight, or two to be compared, as MPEG-4 with H.264.

    Args:
        flights: flights with samples; two share one arena, and each has its own colour.
        out: the file.
        camera: overview, chase or top.
        colour: what the drones' colour tells: speed or danger.
        fps: frames a second.
        speed: simulated over shown time; by default real time, or what makes the video a minute long.
        size: width and height, pixels.
        processes: that render; as many as there are processors by default.
        progress: told the share that is done, from 0 to 1.

    Raises:
        RenderError: a setting is out of bounds, there is no GL or no codec, or the file cannot be written.
    """
    _check(camera, fps, speed, size)
    playback = playback_of(flights, colour=colour, names=flight_names(flights))
    seconds = playback.end - playback.begin
    speed = speed or max(1.0, seconds / _WATCHABLE)
    times = playback.begin + np.arange(max(round(seconds / speed * fps), 1)) * speed / fps
    with new_file(out) as place, _Encoder(place, fps, size) as encoder:
        for number, frame in enumerate(_frames(playback, times, camera, speed, size, processes), start=1):
            encoder.add(frame)
            if progress:
                progress(number / len(times))


def find_gl() -> str:
    """The way to render without a screen that works here: what MUJOCO_GL says, else egl, else osmesa.

    Raises:
        RenderError: none does.
    """
    asked = os.environ.get("MUJOCO_GL")
    ways = (asked,) if asked else ("egl", "osmesa")
    for way in ways:
        environment = {**os.environ, "MUJOCO_GL": way}
        if (
            subprocess.run([sys.executable, "-c", _PROBE], env=environment, capture_output=True, check=False).returncode
            == 0
        ):
            return way
    raise RenderError(f"video: no GL: {' and '.join(ways)} failed; on Debian: apt-get install libegl1 libosmesa6")


def _check(camera: str, fps: int, speed: float | None, size: tuple[int, int]) -> None:
    if camera not in CAMERAS:
        raise RenderError(f"camera: {camera!r} is unknown; there are {', '.join(CAMERAS)}")
    if not 1 <= fps <= 240:
        raise RenderError(f"fps: {fps} is out of bounds: it must be at least 1 and at most 240")
    if speed is not None and not 0 < speed <= 1e4:
        raise RenderError(f"speed: {speed:g} is out of bounds: it must be over 0 and at most 10000")
    if any(side % 2 or not 64 <= side <= 8192 for side in size):
        raise RenderError(
            f"size: {size[0]}x{size[1]} is out of bounds: each must be even, at least 64 and at most 8192"
        )


def _frames(
    playback: Playback,
    times: NDArray[np.float64],
    camera: str,
    speed: float,
    size: tuple[int, int],
    processes: int | None,
) -> Iterator[NDArray[np.uint8]]:
    """The frames in order, (height, width, 3); only so many are under way that memory stays small."""
    processes = processes or len(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory(prefix="moflock-video-") as folder, _rendering_by(find_gl()):
        playback.save(Path(folder))
        pool = ProcessPoolExecutor(
            processes,
            mp_context=multiprocessing.get_context("spawn"),
            initializer=_open_studio,
            initargs=(folder, camera, speed, size),
        )
        with pool:
            waiting: collections.deque[Future[NDArray[np.uint8]]] = collections.deque()
            try:
                for time in times.tolist():
                    waiting.append(pool.submit(_shoot, time))
                    if len(waiting) >= _AHEAD * processes:
                        yield waiting.popleft().result()
                while waiting:
                    yield waiting.popleft().result()
            except BrokenProcessPool:
                raise RenderError("video: a rendering process died; a smaller size needs less memory") from None
            finally:
                pool.shutdown(wait=False, cancel_futures=True)


_studio: Any = None
"""In a process that renders: what it renders with."""


@contextlib.contextmanager
def _rendering_by(way: str) -> Iterator[None]:
    """Let processes that are started now find MUJOCO_GL set, which MuJoCo reads when it is imported."""
    before = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = way
    try:
        yield
    finally:
        if before is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = before


def _open_studio(folder: str, camera: str, speed: float, size: tuple[int, int]) -> None:
    """Make a rendering process ready."""
    global _studio  # noqa: PLW0603 - a pool hands nothing from its initializer to its tasks but this
    from moflock_mj.studio import Studio  # noqa: PLC0415

    _studio = Studio(Playback.load(Path(folder)), camera, speed, size)


def _shoot(time: float) -> NDArray[np.uint8]:
    frame: NDArray[np.uint8] = _studio.shoot(time)
    return frame


class _Encoder:
    """An H.264 file that frames are added to."""

    def __init__(self, path: Path, fps: int, size: tuple[int, int]) -> None:
        try:
            import av  # noqa: PLC0415 - an extra
        except ImportError:
            raise RenderError("video: PyAV is not installed; pip install 'moflock-mj[video]'") from None
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
