"""Run directory with a configuration and an archive of evaluations that survives a killed process.

The archive is an SQLite database with a write-ahead log, one row per evaluation. Each evaluation is committed when it
ends, so a killed process loses no committed row, and the file can be read while the search runs. Each row carries a
checksum, because SQLite's pages have none.
"""

from __future__ import annotations

import contextlib
import fcntl
import importlib.metadata
import json
import math
import os
import sqlite3
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from controllers.policies.interface import PolicySpec
from controllers.policies.registry import make_params, values_of
from moflock_mj.errors import MoflockError, SearchError
from moflock_mj.scenario.scenario import Scenario
from optimize.evaluation.evaluation import Evaluation


def _columns(policy: PolicySpec) -> tuple[str, ...]:
    """Column definitions of the table of evaluations."""
    return (
        "number INTEGER PRIMARY KEY",
        "generation INTEGER NOT NULL",
        *(f"{name} REAL NOT NULL" for name in policy.names),
        "seeds TEXT NOT NULL",  # JSON, [S]
        "order_parameters TEXT NOT NULL",  # JSON, [S][6]
        "fitness TEXT NOT NULL",  # JSON, [S][6 or 7]
        "figures TEXT NOT NULL",  # JSON, [S][F]
        "seconds REAL NOT NULL",
        "worker TEXT NOT NULL",
        "outcome TEXT NOT NULL",
        "flown_at REAL NOT NULL",  # s since 1970
        "checksum INTEGER NOT NULL",
    )


Read = TypeVar("Read")
"""Type that `read_directory` returns."""


_SMALLEST_ROW = 100
"""Lower bound of the size of an evaluation's row, bytes."""


class Entry(NamedTuple):
    """A row of the archive.

    Attributes:
        generation: generation of the algorithm, from 0.
        evaluation: the archived evaluation.
        flown_at: time at which the evaluation was committed, s since 1970.
    """

    generation: int
    evaluation: Evaluation
    flown_at: float


class Archive:
    """Directory with the evaluations so far; close it, or use it in a `with` statement.

    Args:
        path: the directory.
        policy: the policy whose parameters are evaluated.
        database: file name of the archive in the directory.

    Attributes:
        path: the directory.
        damaged: number of damaged rows found by `count_damaged`; a resumed search evaluates them again.
    """

    def __init__(self, path: Path, policy: PolicySpec, database: str = "archive.sqlite") -> None:
        self.path = path
        self._policy = policy
        self._names = tuple(column.split()[0] for column in _columns(policy))
        self._insert = f"INSERT OR REPLACE INTO evaluations VALUES ({','.join('?' * len(self._names))})"
        self._database = path / database
        self.damaged = 0
        with _as_search_error(self._database):
            self._connection = self._connect()

    def repair(self) -> None:
        """Replace a damaged archive by a new one with its intact rows; the damaged file is kept as `.damaged`.

        Raises:
            SearchError: the archive cannot be written.
        """
        if not self.damaged:
            return
        with _as_search_error(self._database):
            rows = [_row_of(entry) for entry in self._intact()]
            self._connection.close()
            for ending in ("-wal", "-shm"):
                Path(f"{self._database}{ending}").unlink(missing_ok=True)
            self._database.replace(self._database.with_suffix(".damaged"))
            self._connection = self._connect()
            with self._connection:
                self._connection.executemany(self._insert, rows)
        self.damaged = 0

    def append(self, evaluation: Evaluation, generation: int) -> None:
        """Commit one evaluation; a row with the same number is replaced.

        Raises:
            SearchError: the row cannot be written, for example because the disk is full; earlier rows are kept.
        """
        row = _row_of(Entry(generation, evaluation, time.time()))
        with _as_search_error(self._database), self._connection:
            self._connection.execute(self._insert, row)

    def entries(self) -> Iterator[Entry]:
        """Intact rows, in the order of their numbers."""
        with _as_search_error(self._database):
            yield from self._intact()

    def evaluations(self, generation: int | None = None) -> list[Evaluation]:
        """Intact evaluations of one generation, or of all, in the order of their numbers."""
        return [entry.evaluation for entry in self.entries() if generation in (None, entry.generation)]

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Hold an exclusive lock on this directory.

        Raises:
            SearchError: another command holds the lock.
        """
        folder = os.open(self.path, os.O_RDONLY)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield
        except BlockingIOError:
            raise SearchError(f"run directory {self.path}: another command is running in it") from None
        finally:
            os.close(folder)

    def close(self) -> None:
        """Close the archive; SQLite then merges the write-ahead log into the file."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def count_damaged(self) -> int:
        """Count the damaged rows (at least 1 if SQLite cannot), set `damaged` to their number and return it."""
        with _as_search_error(self._database):
            intact = sum(1 for _ in self._intact())
            try:
                claimed = self._connection.execute("SELECT count(*) FROM evaluations").fetchone()[0]
            except sqlite3.DatabaseError:
                claimed = intact + 1
        self.damaged = int(claimed) - intact
        return self.damaged

    def _connect(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self._database, timeout=10)
        try:
            connection.execute("PRAGMA journal_mode=WAL")
            # The log is synced only when it is merged into the file: a killed process loses no row, a power cut at
            # most the last rows, which are evaluated again.
            connection.execute("PRAGMA synchronous=NORMAL")
            connection.execute(f"CREATE TABLE IF NOT EXISTS evaluations ({', '.join(_columns(self._policy))})")
            connection.commit()
        except BaseException:
            connection.close()
            raise
        return connection

    def _rows(self) -> Iterator[tuple[Any, ...]]:
        """Rows that SQLite can still read, in the order of their numbers."""
        select = f"SELECT {', '.join(self._names)} FROM evaluations"
        try:
            yield from self._connection.execute(f"{select} ORDER BY number").fetchall()
        except sqlite3.DatabaseError:
            # A damaged page ends a scan, but single rows outside it can still be read.
            for number in range(self._max_rows()):
                with contextlib.suppress(sqlite3.DatabaseError):
                    yield from self._connection.execute(f"{select} WHERE number = ?", (number,)).fetchall()

    def _max_rows(self) -> int:
        """Upper bound of the number of rows that the file can hold."""
        return self._database.stat().st_size // _SMALLEST_ROW + 1

    def _intact(self) -> Iterator[Entry]:
        return (entry for row in self._rows() if (entry := _entry_of(row, self._policy)) is not None)


def write_directory(path: Path, scenario: Scenario, configuration: str) -> None:
    """Create a directory with a scenario, `scenario.toml`, and a configuration, `configuration.json`.

    Raises:
        SearchError: the directory is not empty or cannot be written.
    """
    check_new(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        _write(path / "scenario.toml", scenario.to_toml())
        _write(path / "configuration.json", configuration)
    except OSError as error:
        raise SearchError(f"run directory {path}: {error.strerror}") from None


def check_new(path: Path) -> None:
    """Check that a path is an empty directory or does not exist.

    Raises:
        SearchError: the directory is not empty, or the path is not a directory.
    """
    try:
        if path.exists() and any(path.iterdir()):
            raise SearchError(f"run directory {path}: it is not empty; it must be new or be resumed")
    except OSError as error:
        raise SearchError(f"run directory {path}: {error.strerror}") from None


def is_directory(path: Path) -> bool:
    """Whether the path is a directory that `write_directory` created."""
    return (path / "configuration.json").is_file()


def read_directory(path: Path, read: Callable[[str, str], Read]) -> Read:
    """Return `read(configuration, scenario)` for the two texts that `write_directory` wrote.

    Raises:
        SearchError: the files are missing or cannot be read.
    """
    if not is_directory(path):
        raise SearchError(f"run directory {path}: it must hold a configuration.json")
    try:
        return read(
            (path / "configuration.json").read_text(encoding="utf-8"),
            (path / "scenario.toml").read_text(encoding="utf-8"),
        )
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise SearchError(f"run directory {path}: {reason}") from None
    except MoflockError as error:
        raise SearchError(f"run directory {path}: {error}") from None


def _row_of(entry: Entry) -> tuple[Any, ...]:
    evaluation = entry.evaluation
    values = (
        evaluation.number,
        entry.generation,
        *values_of(evaluation.params).values(),
        json.dumps(evaluation.seeds),
        json.dumps(_without_nan(evaluation.order_parameters)),
        json.dumps(evaluation.fitness.tolist()),
        json.dumps(_without_nan(evaluation.figures)),
        evaluation.seconds,
        evaluation.worker,
        evaluation.outcome,
        entry.flown_at,
    )
    return (*values, _checksum(values))


def _entry_of(row: tuple[Any, ...], policy: PolicySpec) -> Entry | None:
    """Entry of a row; None if the checksum does not match."""
    *values, checksum = row
    if _checksum(values) != checksum:
        return None
    point_end = 2 + len(policy.parameters)
    number, generation, *point = values[:point_end]
    seeds, order_parameters, fitness, figures, seconds, worker, outcome, flown_at = values[point_end:]
    evaluation = Evaluation(
        number=number,
        params=make_params(policy, point),
        seeds=tuple(json.loads(seeds)),
        order_parameters=np.array(json.loads(order_parameters), np.float64),  # null becomes NaN
        fitness=np.array(json.loads(fitness), np.float64),
        figures=np.array(json.loads(figures), np.float64),
        seconds=seconds,
        worker=worker,
        outcome=outcome,
    )
    return Entry(generation, evaluation, flown_at)


def _checksum(values: Sequence[Any]) -> int:
    return zlib.crc32(repr(tuple(values)).encode("utf-8", "replace"))


def _without_nan(array: NDArray[np.float64]) -> list[list[float | None]]:
    return [[value if math.isfinite(value) else None for value in row] for row in array.tolist()]


def _write(path: Path, text: str) -> None:
    """Write a file atomically."""
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


@contextlib.contextmanager
def _as_search_error(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        raise SearchError(f"archive {path}: {error}") from None
    except OSError as error:
        raise SearchError(f"archive {path}: {error.strerror}") from None


_LIBRARIES = ("moflock-mj", "numpy", "pymoo", "cma")


def installed_versions(libraries: Sequence[str] = _LIBRARIES) -> dict[str, str]:
    """Installed versions of the libraries; by default those on which a search's result depends."""
    return {name: importlib.metadata.version(name) for name in libraries}
