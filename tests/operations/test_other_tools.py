"""Other people's readers of our logs: @mcap/core, Rerun; and what Foxglove, Lichtblick and Rerun are given for them."""

import gzip
import json
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from moflock_mj import Scenario, fly, load_point, read_log
from moflock_mj.errors import RenderError
from moflock_mj.log.foxglove_layout import BLUEPRINT_FILE, PLOTS, viewer_layout
from moflock_mj.log.scene_encoder import arena_points
from moflock_mj.log.schemas import CHANNELS, Metrics
from moflock_mj.visualization.viewer_layouts import export_layouts

needs_rerun = pytest.mark.skipif(not find_spec("rerun_cli"), reason="rerun-sdk is not installed: the extra `rerun`")
NODE_PACKAGES = ("@mcap/core@2.2.2", "fzstd@0.1.1")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "flight.mcap"
    scenario = Scenario(drones=5, duration=12.0, arena_side=100.0, start_spacing=5.0)
    fly(load_point("B"), scenario=scenario, log=path)
    return path


def rerun(*arguments: object) -> str:
    command = [sys.executable, "-m", "rerun_cli", *map(str, arguments)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.fixture(scope="session")
def node_packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the JavaScript reader."""
    npm = shutil.which("npm")
    if not npm or not shutil.which("node"):
        pytest.skip("no node and npm here for @mcap/core")
    folder = tmp_path_factory.mktemp("node")
    command = [npm, "install", "--no-audit", "--no-fund", "--prefix", str(folder), *NODE_PACKAGES]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    if ended.returncode:
        pytest.skip(f"npm cannot install {NODE_PACKAGES[0]} here: {ended.stderr.strip()[-200:]}")
    return folder


@pytest.mark.slow
def test_the_javascript_reader_finds_every_record_and_every_checksum_right(log: Path, node_packages: Path) -> None:
    script = Path(__file__).with_name("read_log.mjs")
    command = ["node", str(script), str(log), str(node_packages)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    flight = read_log(log)
    assert told["done"]
    assert told["messages"]["/swarm/points"] == told["messages"]["/metrics"] == flight.samples.t.size
    assert set(told["messages"]) <= set(CHANNELS)
    assert told["indexed"] == sum(told["messages"].values())
    assert set(told["attachments"]) == set(flight.attachments)
    assert told["metadata"] == ["moflock.run", "moflock.result"]


@pytest.mark.slow
@needs_rerun
def test_rerun_finds_no_fault_in_a_log(log: Path) -> None:
    told = rerun("mcap", "check", "--full", log)
    lines = {parts[3]: parts[0] for line in told.splitlines() if len(parts := line.split()) >= 4 and "/" in parts[3]}
    assert set(lines.values()) == {"ok"}
    assert "/swarm/points" in lines


@pytest.mark.slow
@needs_rerun
def test_rerun_draws_drones_and_arena_without_a_blueprint(log: Path, tmp_path: Path) -> None:
    rerun("mcap", "convert", log, "-o", tmp_path / "a.rrd")
    # Components that it cannot draw, such as a pose without a position, are only found here.
    rerun("rrd", "verify", tmp_path / "a.rrd")
    told = rerun("rrd", "print", tmp_path / "a.rrd")
    for entity in ("/swarm/points", "/arena"):
        assert any(f" {entity} " in line and "Points3D:positions" in line for line in told.splitlines())
    assert "moflock.Metrics:message" in told


@pytest.mark.slow
@needs_rerun
def test_exported_files_are_those_of_the_log_and_rerun_takes_them(log: Path, tmp_path: Path) -> None:
    layout, blueprint, recording = export_layouts(log, tmp_path / "new")
    assert (layout.name, blueprint.name, recording.name) == ("layout.json", "blueprint.rbl", "flight.rrd")
    assert layout.read_bytes() == viewer_layout(100.0)
    assert blueprint.read_bytes() == gzip.decompress(BLUEPRINT_FILE.read_bytes())
    rerun("rrd", "verify", blueprint, recording)
    told = rerun("rrd", "print", "-vvv", blueprint)
    for title, fields, _ in PLOTS:
        assert title in told
        assert all(field in told for field in fields if field.startswith("phi"))
    assert len(list((tmp_path / "new").iterdir())) == 3


def test_a_log_of_another_release_has_no_layout(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flight = read_log(log)
    monkeypatch.delitem(flight.attachments, "layout.json")  # type: ignore[arg-type]
    with pytest.raises(RenderError, match=r"flight\.mcap has no attachment layout\.json"):
        export_layouts(flight, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "content",
    [gzip.compress(bytes(1 << 25)), b"no gzip", gzip.compress(b"cut off")[:-9], gzip.compress(b"x" * 99)[:12]],
    ids=["bomb", "no gzip", "cut off", "head alone"],
)
def test_a_hostile_blueprint_is_refused(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes
) -> None:
    flight = read_log(log)
    monkeypatch.setitem(flight.attachments, "blueprint.rbl.gz", content)  # type: ignore[arg-type]
    with pytest.raises(RenderError, match=r"attachment blueprint\.rbl\.gz: "):
        export_layouts(flight, tmp_path)
    assert not list(tmp_path.iterdir())


def panels_in(layout: Any) -> list[str]:
    return [layout] if isinstance(layout, str) else panels_in(layout["first"]) + panels_in(layout["second"])


def test_the_layout_shows_each_of_its_panels_and_only_fields_that_exist() -> None:
    layout = json.loads(viewer_layout(500.0))
    assert sorted(panels_in(layout["layout"])) == sorted(layout["configById"])
    assert {name.partition("!")[0] for name in layout["configById"]} == {"3D", "Plot", "RosOut"}
    for name, panel in layout["configById"].items():
        if name.startswith("Plot!"):
            assert panel["lichtblickPanelTitle"] == panel["foxglovePanelTitle"]
            for path in panel["paths"]:
                topic, _, field = path["value"].partition(".")
                assert topic == "/metrics"
                assert field in Metrics.DESCRIPTOR.fields_by_name
    assert set(layout["configById"]["3D!flock"]["topics"]) <= set(CHANNELS)


def test_the_dots_of_the_arena_lie_on_its_edges() -> None:
    outline = np.array([[-50.0, -50.0], [50.0, -50.0], [50.0, 50.0], [-50.0, 50.0]])
    cloud = arena_points(outline, altitude=20.0)
    dots = np.frombuffer(cloud.data, np.dtype([("place", "<f4", (3,)), ("rgba", "u1", (4,))]))["place"]
    assert set(dots[:, 2].tolist()) == {0.0, 20.0, 40.0}
    assert (np.abs(dots[:, :2]).max(axis=1) == 50).all()
    assert {tuple(corner) for corner in outline.tolist()} <= {tuple(place) for place in dots[:, :2].tolist()}
