"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from moflock_mj.errors import RenderError


@contextlib.contextmanager
def new_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A place beside `path` to be written to, which takes its name, and the place of what was there, at the end.

    The place ends like `path`, since many writers choose their format by that. It is removed if writing fails.

    Args:
        path: the file to be; its folders are made.

    Raises:
        RenderError: the file cannot be written.
    """
    path = Path(path)
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        if path.is_dir():
            raise RenderError(f"{path}: it is a folder, must be a file")
        path.parent.mkdir(parents=True, exist_ok=True)
        yield part
        part.replace(path)
    except OSError as problem:
        raise RenderError(f"{path}: {problem.strerror or problem}") from problem
    finally:
        with contextlib.suppress(OSError):
            part.unlink()
