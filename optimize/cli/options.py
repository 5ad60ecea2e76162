"""The search's verbs of the command `moflock`: their options, and nothing else; what they do is in `verbs`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moflock_mj.errors import SearchError

if TYPE_CHECKING:
    from moflock_mj.parameters.bounds import ParameterBounds


Duration = Annotated[float | None, typer.Option(help="Simulated seconds of each flight.")]


BoundsFile = Annotated[Path | None, typer.Option("--bounds", help="TOML or JSON file; the paper's if absent.")]


Workers = Annotated[int, typer.Option(help="Local processes.")]


Scheduler = Annotated[str | None, typer.Option(help="Fly on a Dask cluster instead, at tcp://host:port.")]


RunPath = Annotated[Path, typer.Argument(help="A search's directory.", metavar="RUN")]


CORES = os.cpu_count() or 1


_FRONT_SEEDS = 100


FrontSeeds = Annotated[
    int | None,
    typer.Option(help=f"Fly the front again if it has flown fewer fresh seeds; {_FRONT_SEEDS} if it has none.", min=2),
]


def refuse_with_resume(given: Mapping[str, Any]) -> None:
    """Refuse what a run that is resumed has of its own already; None for what was not given.

    Raises:
        SearchError: something was given.
    """
    for name, value in given.items():
        if value is not None:
            raise SearchError(f"resume: the run has its own {name}, which cannot be given again")


def given_bounds(path: Path | None) -> ParameterBounds:
    """The bounds of a file, or the paper's."""
    from moflock_mj.parameters.bounds import load_bounds, policy_bounds

    return load_bounds(path) if path else policy_bounds()


def numbers_of(name: str, text: str) -> list[float]:
    """Numbers of a text such as 250,250."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise SearchError(f"{name}: {text!r} is of the wrong type: it must be numbers with commas between") from None
