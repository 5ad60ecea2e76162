"""Options that several commands of searches share."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moflock_mj.errors import SearchError

if TYPE_CHECKING:
    from moflock_mj.parameters.bounds import ParameterBounds


Duration = Annotated[float | None, typer.Option(help="Duration of each flight, simulated seconds.")]


BoundsFile = Annotated[
    Path | None, typer.Option("--bounds", help="Bounds of the parameters, TOML or JSON file (default: the paper's).")
]


Workers = Annotated[int, typer.Option(help="Number of local processes.")]


Scheduler = Annotated[
    str | None, typer.Option(help="Address of a Dask scheduler, tcp://host:port, to use instead of local processes.")
]


RunPath = Annotated[Path, typer.Argument(help="Directory of a search.", metavar="RUN")]


CORES = os.cpu_count() or 1


FRONT_SEEDS = 100


FrontSeeds = Annotated[
    int | None,
    typer.Option(
        help=f"Least number of fresh seeds; a front with fewer is flown again (default: {FRONT_SEEDS}).", min=2
    ),
]


def refuse_with_resume(given: Mapping[str, Any]) -> None:
    """Check that no option is given that a resumed run already has; None stands for an absent option.

    Raises:
        SearchError: an option is given.
    """
    for name, value in given.items():
        if value is not None:
            raise SearchError(f"resume: the run has its own {name}, which cannot be given again")


def given_bounds(path: Path | None) -> ParameterBounds:
    """Bounds from a file, or the paper's bounds."""
    from moflock_mj.parameters.bounds import load_bounds, policy_bounds

    return load_bounds(path) if path else policy_bounds()


def numbers_of(name: str, text: str) -> list[float]:
    """Numbers of a text such as 250,250."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise SearchError(f"{name}: {text!r} is of the wrong type: it must be numbers separated by commas") from None
