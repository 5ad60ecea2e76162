"""Points given by name, by file, or by the directory of a search."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from moflock_mj.errors import PointError, SearchError
from moflock_mj.parameters.points import check_point, load_point, point_names
from optimize.search.findings import FRONT
from optimize.search.front import load_front
from optimize.search.run_directory import RunDirectory


def read_points(sources: Sequence[str]) -> tuple[dict[str, NamedTuple], set[int]]:
    """Read points by name, and the seeds that the searches among the sources have used.

    Args:
        sources: named points, .json files, and search directories, which stand for the points of their fronts.

    Raises:
        MoflockError: a point or directory does not exist, or two points have the same name.
    """
    points: dict[str, NamedTuple] = {}
    used: set[int] = set()
    for name in sources:
        path = Path(name)
        if path.is_dir():
            found, seeds = _front_points(path)
            used |= seeds
        elif path.suffix == ".json" or name in point_names():
            found = {path.stem: load_point(name)}
        else:
            known = ", ".join(point_names())
            raise PointError(f"point {name}: unknown; it must be one of {known}, a .json file or a search directory")
        for key, params in found.items():
            if key in points:
                raise PointError(f"point {key}: it is given twice")
            points[key] = params
    return points, used


def _front_points(path: Path) -> tuple[dict[str, NamedTuple], set[int]]:
    """Points of a search's re-evaluated front, and the seeds that the search and the front have used."""
    with RunDirectory.open(path) as run:
        used = {seed for evaluation in run.evaluations() for seed in evaluation.seeds}
    if not (path / FRONT).is_file():
        raise SearchError(f"run directory {path}: its front must be flown first: moflock report {path}")
    front = load_front(path / FRONT)
    used |= set(front.seeds)
    points = {
        f"{path.resolve().name}-{number}": check_point(front.params(number)) for number in front.remaining.tolist()
    }
    return points, used
