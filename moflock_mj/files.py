"""Atomic writing of files, and reading of files with a size limit."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from moflock_mj.errors import RenderError


def read_limited(path: str | os.PathLike[str], most: int) -> bytes:
    """Read a file of at most `most` bytes.

    Raises:
        OSError: the file cannot be read or is too large; `strerror` states the reason.
    """
    with Path(path).open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(None, f"over {most} bytes; it must be at most {most} bytes")
    return content


@contextlib.contextmanager
def new_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path`, and rename it to `path` at the end.

    The suffix is that of `path`, because many writers select their format by it. The temporary file is removed if
    writing fails.

    Args:
        path: file to write or replace; its folders are created.

    Raises:
        RenderError: the file cannot be written.
    """
    path = Path(path)
    part = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        make_folder(path)
        yield part
        part.replace(path)
    except OSError as problem:
        raise RenderError(f"{path}: {problem.strerror or problem}") from problem
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


def make_folder(path: Path) -> None:
    """Create the folders of a new file, and check that the file replaces nothing but a file.

    Raises:
        OSError: the file cannot be written; `strerror` states the reason.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise OSError(None, f"not a folder: {path.parent}") from None
    if path.is_dir():
        raise OSError(None, "it is a folder, must be a file")
    # A rename would replace a device such as /dev/full by a file.
    if path.exists() and not path.is_file():
        raise OSError(None, "it is a device or a pipe, must be a file")
