"""Worker process that renders a part of a video's frames: `python -m moflock_mj.rendering.render_worker FOLDER NUMBER`.

It is a separate program because MuJoCo reads MUJOCO_GL when it is first imported, and because the pipe to it lets
either side detect that the other one has ended.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import NamedTuple

from moflock_mj.visualization.playback import Playback


class RenderJob(NamedTuple):
    """Job of the worker processes, saved in a folder beside the playback.

    Attributes:
        camera: overview, chase or top.
        speed: simulated seconds per second of video.
        size: width and height, pixels.
        times: times of the frames, s.
        processes: number of processes; each of n renders every n-th frame.
    """

    camera: str
    speed: float
    size: tuple[int, int]
    times: list[float]
    processes: int

    def save(self, folder: Path) -> None:
        (folder / "job.json").write_text(json.dumps(self), encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> RenderJob:
        camera, speed, (width, height), times, processes = json.loads((folder / "job.json").read_text("utf-8"))
        return cls(camera, speed, (width, height), times, processes)


def main() -> None:
    """Write the frames, as bytes of (height, width, 3), to stdout."""
    from moflock_mj.rendering.renderer import VideoRenderer  # noqa: PLC0415 - loads the GL, which only this process needs

    folder, number = Path(sys.argv[1]), int(sys.argv[2])
    job = RenderJob.load(folder)
    renderer = VideoRenderer(Playback.load(folder), job.camera, job.speed, job.size)
    try:
        with os.fdopen(sys.stdout.fileno(), "wb", closefd=False) as out:
            for time in job.times[number :: job.processes]:
                out.write(renderer.shoot(time).tobytes())
    except BrokenPipeError:
        pass  # the reader has ended
    # A driver's clean-up at the end of a process can fail with messages; it is not needed.
    os._exit(0)


if __name__ == "__main__":
    main()
