"""The HTML page: that it is complete in itself, and that a browser without a network shows the flight."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from moflock_mj import Flight, Scenario, fly, load_point
from moflock_mj.errors import RenderError
from moflock_mj.visualization.html_page import write_page

pytest.importorskip("viser", reason="viser is not installed: the extra `html`")

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
HEADLESS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--no-default-browser-check", "--hide-scrollbars"),
    "--host-resolver-rules=MAP * ~NOTFOUND",
)


def flown(point: str) -> Flight:
    scenario = Scenario(drones=8, duration=12.0, arena_side=120.0, start_spacing=5.0)
    return fly(load_point(point), scenario=scenario, dynamics="point_mass")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("page") / "a.html"
    write_page(flown("A"), out)
    return out


def test_page_has_the_figures_and_what_its_colours_mean(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for part in (
        "<title>point A - moflock</title>",
        "8 point masses",
        "seed 1",
        "F_1 = ",
        "has touched",
        "times a drone",
    ):
        assert part in text
    assert len(text) < 2_000_000


def test_page_names_no_address(page: Path) -> None:
    addresses = set(re.findall(r"(?:https?|wss?)://[\w.-]+\.\w+", page.read_text(encoding="utf-8")))
    assert addresses <= {"http://www.w3.org"}


def test_nothing_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_page([flown("A"), flown("B")], tmp_path / "ab.html")
    assert capsys.readouterr() == ("", "")
    text = (tmp_path / "ab.html").read_text(encoding="utf-8")
    assert "<title>point A and point B - moflock</title>" in text


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RenderError, match=r"file/a\.html: "):
        write_page(flown("A"), tmp_path / "file" / "a.html")


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium here to show the page")
def test_browser_shows_the_flight_and_asks_the_network_for_nothing(page: Path, tmp_path: Path) -> None:
    shot, net = tmp_path / "shot.png", tmp_path / "net.json"
    command = [str(BROWSER), *HEADLESS, f"--user-data-dir={tmp_path / 'profile'}", "--window-size=640,480"]
    command += [f"--log-net-log={net}", "--virtual-time-budget=2500", f"--screenshot={shot}", page.as_uri()]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert shot.exists(), ended.stderr[-2000:]
    with Image.open(shot) as image:
        rgb = np.asarray(image.convert("RGB")).astype(int)
    scene = rgb[120:420]
    walls = (np.abs(scene - [120, 170, 220]) < 45).all(axis=2)
    assert walls.sum() > 300, "no arena"
    vivid = (scene.max(axis=2) > 140) & (np.ptp(scene, axis=2) > 90)
    assert vivid.sum() > 30, "no drones"
    assert asked_for(net) == []


def asked_for(net_log: Path) -> list[str]:
    """Addresses that the page asked for; the browser's own questions have no origin."""
    log = json.loads(net_log.read_text(encoding="utf-8"))
    begins = log["constants"]["logEventTypes"]["URL_REQUEST_START_JOB"]
    asked = [event["params"] for event in log["events"] if event["type"] == begins and "url" in event.get("params", {})]
    return [one["url"] for one in asked if one.get("initiator") != "not an origin"]
