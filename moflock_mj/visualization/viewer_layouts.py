"""Takes out of a log what viewers need: a layout for Foxglove and Lichtblick, a blueprint for Rerun."""

from __future__ import annotations

import contextlib
import gzip
import io
import os
import subprocess
import sys
import tempfile
import zlib
from importlib.util import find_spec
from pathlib import Path

from moflock_mj.errors import RenderError
from moflock_mj.files import new_file
from moflock_mj.log.foxglove_layout import BLUEPRINT_NAME, LAYOUT_NAME
from moflock_mj.log.reader import LoggedFlight, read_log
from moflock_mj.log.rerun_blueprint import APPLICATION

_PATIENCE = 600
"""Seconds that Rerun has to convert a log; it takes 2 for 600 s of 30 drones."""


_LARGEST_BLUEPRINT = 1 << 24
"""Bytes; ours has 200 thousand."""


def export_layouts(log: LoggedFlight | str | os.PathLike[str], folder: str | os.PathLike[str]) -> list[Path]:
    """Write a log's layout.json and blueprint.rbl into a folder; where Rerun is installed, NAME.rrd as well.

    Foxglove and Lichtblick import the layout. Rerun applies the blueprint to a log that is open already. NAME.rrd is
    the log with the blueprint in it, which Rerun shows as it should without more ado.

    Args:
        log: a flight that was read from its log, or the log's path.
        folder: where they go; it is made.

    Returns:
        What was written.

    Raises:
        RenderError: the log holds no layout, Rerun cannot convert it, or a file cannot be written.
        LogError: the log cannot be read.
    """
    flight = log if isinstance(log, LoggedFlight) else read_log(Path(log))
    missing = [name for name in (LAYOUT_NAME, BLUEPRINT_NAME) if name not in flight.attachments]
    if missing:
        raise RenderError(f"layouts: {flight.log} has no attachment {missing[0]}; another release has written it")
    layout, blueprint = Path(folder) / LAYOUT_NAME, Path(folder) / BLUEPRINT_NAME.removesuffix(".gz")
    written = [layout, blueprint]
    with contextlib.ExitStack() as places:  # all of them appear, or none
        layout_place, blueprint_place = (places.enter_context(new_file(path)) for path in written)
        layout_place.write_bytes(flight.attachments[LAYOUT_NAME])
        blueprint_place.write_bytes(_unpacked(flight.attachments[BLUEPRINT_NAME]))
        if find_spec("rerun_cli"):
            written.append(Path(folder) / f"{flight.log.stem}.rrd")
            recording = places.enter_context(new_file(written[-1]))
            bare = Path(places.enter_context(tempfile.TemporaryDirectory())) / "bare.rrd"
            _rerun("mcap", "convert", str(flight.log), "--application-id", APPLICATION, "-o", str(bare))
            _rerun("rrd", "merge", str(bare), str(blueprint_place), "-o", str(recording))
    return written


def _rerun(*arguments: str) -> None:
    """Run Rerun's own command."""
    command = [sys.executable, "-m", "rerun_cli", *arguments]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE, check=False)
    if ended.returncode:
        lines = ended.stderr.strip().splitlines() or [f"exit status {ended.returncode}"]
        raise RenderError(f"layouts: rerun {arguments[0]} {arguments[1]}: {lines[-1]}")


def _unpacked(data: bytes) -> bytes:
    """A gzip file's content, if it is as small as a blueprint is."""
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
            content = file.read(_LARGEST_BLUEPRINT + 1)
    except (OSError, EOFError, zlib.error) as problem:
        raise RenderError(f"layouts: attachment {BLUEPRINT_NAME}: {problem}") from problem
    if len(content) > _LARGEST_BLUEPRINT:
        raise RenderError(f"layouts: attachment {BLUEPRINT_NAME}: it must unpack to at most {_LARGEST_BLUEPRINT} bytes")
    return content
