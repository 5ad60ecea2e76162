"""Export of viewer layouts from a log: a layout for Foxglove and Lichtblick, a blueprint for Rerun."""

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
"""Time for Rerun to convert a log, s; it takes 2 s for 600 s of 30 drones."""


_LARGEST_BLUEPRINT = 1 << 24
"""Maximum size of a blueprint, bytes; ours has about 200 kB."""


def export_layouts(log: LoggedFlight | str | os.PathLike[str], folder: str | os.PathLike[str]) -> list[Path]:
    """Write a log's layout.json and blueprint.rbl to a folder, and NAME.rrd if Rerun is installed.

    Foxglove and Lichtblick import the layout. Rerun applies the blueprint to a log that is already open. NAME.rrd
    contains the log and the blueprint, so that Rerun shows it with the blueprint applied.

    Args:
        log: a logged flight, or the path of its log.
        folder: folder of the files; it is created if it does not exist.

    Returns:
        Paths of the written files.

    Raises:
        RenderError: the log has no layout, Rerun cannot convert it, or a file cannot be written.
        LogError: the log cannot be read.
    """
    flight = log if isinstance(log, LoggedFlight) else read_log(Path(log))
    missing = [name for name in (LAYOUT_NAME, BLUEPRINT_NAME) if name not in flight.attachments]
    if missing:
        raise RenderError(f"layouts: {flight.log} has no attachment {missing[0]}: it was written by another release")
    layout, blueprint = Path(folder) / LAYOUT_NAME, Path(folder) / BLUEPRINT_NAME.removesuffix(".gz")
    written = [layout, blueprint]
    with contextlib.ExitStack() as places:  # all files appear, or none
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
    """Run the command of Rerun."""
    command = [sys.executable, "-m", "rerun_cli", *arguments]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE, check=False)
    if ended.returncode:
        lines = ended.stderr.strip().splitlines() or [f"exit status {ended.returncode}"]
        raise RenderError(f"layouts: rerun {arguments[0]} {arguments[1]}: {lines[-1]}")


def _unpacked(data: bytes) -> bytes:
    """Unpack a gzip file of at most `_LARGEST_BLUEPRINT` bytes."""
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
            content = file.read(_LARGEST_BLUEPRINT + 1)
    except (OSError, EOFError, zlib.error) as problem:
        raise RenderError(f"layouts: attachment {BLUEPRINT_NAME}: {problem}") from problem
    if len(content) > _LARGEST_BLUEPRINT:
        raise RenderError(f"layouts: attachment {BLUEPRINT_NAME}: it must unpack to at most {_LARGEST_BLUEPRINT} bytes")
    return content
