"""Files that appear whole or not at all, and files that are read only up to a size."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from moflock_mj.errors import RenderError


def read_limited(path: str | os.PathLike[str], most: int) -> bytes:
    """The content of a file of at most so many bytes.

    Raises:
        OSError: it cannot be read, or is larger; `strerror` says why.
    """
    with Path(path).open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(None, f"over {most} bytes; it must be at most {most} bytes")
    return content


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
        make_folder(path)
        yield part
        part.replace(path)
    except OSError as problem:
        raise RenderError(f"{path}: {problem.strerror or problem}") from problem
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


def make_folder(path: Path) -> None:
    """Make the folders of a file to be, and see to it that it would replace nothing but a file.

    Raises:
        OSError: it cannot be written; `strerror` says why.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise OSError(None, f"not a folder: {path.parent}") from None
    if path.is_dir():
        raise OSError(None, "it is a folder, must be a file")
    # Such as /dev/full, whose place a file would take.
    if path.exists() and not path.is_file():
        raise OSError(None, "it is a device or a pipe, must be a file")
