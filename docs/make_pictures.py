"""Makes the pictures of the README: `make pictures`. Needs the extras, ffmpeg's libraries by PyAV, and Chromium."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import av

from moflock_mj import Scenario, fly, paper_point, read_log
from moflock_mj.page import write_page
from moflock_mj.picture import draw_picture
from moflock_mj.video import render_video

PICTURES = Path(__file__).parent / "pictures"
CHROMIUM_FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run",
)  # fmt: skip


def frame_of(video: Path, seconds: float, out: Path) -> None:
    """Save one frame of a video as PNG."""
    with av.open(str(video)) as container:
        for frame in container.decode(video=0):
            if frame.time >= seconds:
                frame.to_image().save(out)
                return


def screenshot(page: Path, out: Path, profile: Path) -> None:
    """Save what a browser shows of a page as PNG."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("pictures: no Chromium; apt-get install chromium")
    command = [chromium, *CHROMIUM_FLAGS, f"--user-data-dir={profile}", "--window-size=1280,720"]
    command += ["--virtual-time-budget=20000", f"--screenshot={out}", page.resolve().as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=300)


def main() -> None:
    PICTURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        log, video, page = (Path(folder) / name for name in ("a.mcap", "a.mp4", "a.html"))
        fly(paper_point("A"), scenario=Scenario(duration=120.0), log=log, keep_samples=False)
        flights = [read_log(log)]
        draw_picture(flights, PICTURES / "picture.png")
        render_video(flights, video)
        with av.open(str(video)) as container:
            length = float(container.duration or 0) / av.time_base
        frame_of(video, 0.5 * length, PICTURES / "video.png")
        write_page(flights, page)
        screenshot(page, PICTURES / "page.png", Path(folder) / "profile")


if __name__ == "__main__":
    main()
