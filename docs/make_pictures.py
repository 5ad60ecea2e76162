"""Create the pictures of the README and the site: `make pictures`. Requires the extras, PyAV and Chromium."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import av
from PIL import Image

from moflock_mj import Scenario, fly, load_point, read_log
from moflock_mj.analysis.verification import resume
from moflock_mj.rendering.video import render_video
from moflock_mj.visualization.flight_figure import save_flight_figure
from moflock_mj.visualization.html_page import write_page

PICTURES = Path(__file__).parent / "pictures"
CHROMIUM_FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run",
)  # fmt: skip


POINT = "A"
"""Point of the pictures, fixed here so that a new default point does not change them."""

MOMENT = 40.0
"""Time of the flight that the video and the page show, s."""

ANIMATED = Scenario(drones=30, arena_side=250.0, duration=90.0, warm_up=20.0)
"""Scenario of the animated picture, flown with the default parameters."""

ANIMATION_BEGIN = 30.0
"""Time at which the animation begins, s; the flock has formed by then."""

ANIMATION_SIZE = 640, 360
"""Width and height, pixels."""

ANIMATION_FPS = 12

WITHOUT_NOTICES = "<style>.mantine-Notifications-root{display:none}</style></head>"
"""Style that hides the page's notice that the browser renders without a graphics card."""


def frame_of(video: Path, seconds: float, out: Path) -> None:
    """Save one frame of a video as PNG."""
    with av.open(str(video)) as container:
        for frame in container.decode(video=0):
            if frame.time >= seconds:
                frame.to_image().save(out)
                return


def screenshot(page: Path, out: Path, profile: Path) -> None:
    """Save a PNG screenshot of a page six seconds after the start of its playback."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("pictures: no Chromium; apt-get install chromium")
    page.write_text(page.read_text("utf-8").replace("</head>", WITHOUT_NOTICES, 1), "utf-8")
    command = [chromium, *CHROMIUM_FLAGS, f"--user-data-dir={profile}", "--window-size=1280,720"]
    command += ["--virtual-time-budget=6000", f"--screenshot={out}", page.resolve().as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=600)


def shrink(picture: Path) -> None:
    """Scale a PNG to three fifths of its size."""
    with Image.open(picture) as image:
        smaller = image.convert("RGB").resize((image.width * 3 // 5, image.height * 3 // 5), Image.Resampling.LANCZOS)
    smaller.save(picture, optimize=True)


def animate(out: Path, folder: Path) -> None:
    """Fly the animated scenario as rigid bodies and save its video as an animated WebP."""
    whole, later, video = (folder / name for name in ("whole.mcap", "later.mcap", "animation.mp4"))
    fly(load_point("steady"), scenario=ANIMATED, log=whole, keep_samples=False)
    resume(read_log(whole), ANIMATION_BEGIN, log=later, keep_samples=False)
    render_video([read_log(later)], video, fps=ANIMATION_FPS, speed=5.0)
    with av.open(str(video)) as container:
        frames = [
            frame.to_image().resize(ANIMATION_SIZE, Image.Resampling.LANCZOS) for frame in container.decode(video=0)
        ]
    frames[0].save(
        out, save_all=True, append_images=frames[1:], duration=round(1000 / ANIMATION_FPS), loop=0, quality=60, method=6
    )


def main() -> None:
    """Create the animation, and all still pictures of a second flight."""
    PICTURES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        animate(PICTURES / "flight.webp", Path(folder))
        log, later, video, page = (Path(folder) / name for name in ("a.mcap", "b.mcap", "a.mp4", "a.html"))
        fly(load_point(POINT), scenario=Scenario(duration=120.0), log=log, keep_samples=False)
        flight = read_log(log)
        save_flight_figure(flight, PICTURES / "picture.png")
        shrink(PICTURES / "picture.png")
        render_video([flight], video, fps=2, speed=4.0)
        frame_of(video, MOMENT / 4.0, PICTURES / "video.png")
        # The page plays its log from the start, so the flight is resumed at the moment to show.
        resume(flight, MOMENT, log=later, keep_samples=False)
        write_page(read_log(later), page)
        screenshot(page, PICTURES / "page.png", Path(folder) / "profile")


if __name__ == "__main__":
    main()
