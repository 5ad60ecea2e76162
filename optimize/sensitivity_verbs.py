"""What `moflock sensitivity` and `moflock sweep` do, from its arguments to what it prints."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from controllers.flocking import FlockingParams
from moflock_mj.bounds import Bounds
from moflock_mj.errors import SearchError
from moflock_mj.new_file import new_file
from moflock_mj.points import load_point
from moflock_mj.scenario import Scenario
from optimize.configuration import search_scenario
from optimize.evaluation import Job
from optimize.figures import save
from optimize.fly_points import check_counts, fresh_seeds
from optimize.kept_flights import Study, kept_flights
from optimize.objectives import FITNESS_NAMES
from optimize.sensitivity import (
    OneAtATime,
    SobolIndices,
    Sweep,
    check_samples,
    one_at_a_time,
    sobol_indices,
    sweep,
    swept_scenarios,
)
from optimize.sensitivity_figures import sensitivity_figure, sweep_figure
from optimize.statistics import half_width
from optimize.tables import Words, rich_table
from optimize.terminal import flights_progress


def sensitivity(
    point: str,
    *,
    scenario: Scenario,
    dynamics: str,
    bounds: Bounds,
    samples: int,
    levels: int,
    seeds: int,
    workers: int,
    scheduler: str | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Fly both studies, print the indices, write JSON and a figure into the folder `out`, where the flights stay.

    Raises:
        MoflockError: what was asked for cannot be flown or written.
    """
    params = load_point(point)
    check_samples(samples)
    check_counts(levels=levels, seeds=seeds)
    job = Job(scenario=search_scenario(scenario, dynamics), dynamics=dynamics)
    asked = {"samples": samples, "levels": levels, "seeds": seeds}
    settings = {"point": params._asdict(), "dynamics": dynamics, "bounds": bounds.to_dict(), **asked}
    study = Study(verb="sensitivity", scenario=job.scenario, settings=settings)
    out = out or study.default_folder()
    with kept_flights(study, out, job, workers, scheduler) as flights:
        with flights_progress("Sobol indices") as told:
            indices = sobol_indices(flights, bounds, samples=samples, told=told)
        with flights_progress("one at a time") as told:
            along = one_at_a_time(flights, params, bounds, seeds=fresh_seeds(seeds), levels=levels, told=told)
        content = json.dumps(_content(point, params, indices, along, seeds), indent=1) + "\n"
        with new_file(out / "sensitivity.json") as place:
            place.write_text(content, encoding="utf-8")
        save(lambda: sensitivity_figure(indices, along, params), out / "sensitivity.png")
    if as_json:
        print(content, end="")
        return 0
    console = Console()
    console.print(rich_table(_table("First order", indices.first, indices.first_width)))
    console.print(rich_table(_table("Total", indices.total, indices.total_width)))
    console.print(f"figure and JSON: {out}", highlight=False, soft_wrap=True)
    return 0


def sweeps(
    point: str,
    fields: Mapping[str, Sequence[float]],
    *,
    scenario: Scenario,
    dynamics: str,
    seeds: int,
    workers: int,
    scheduler: str | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Fly a point over values of scenario fields; print means, write figures and JSON into `out`, with the flights.

    Raises:
        MoflockError: what was asked for cannot be flown or written.
    """
    params = load_point(point)
    if not fields:
        raise SearchError("sweep: no field is given; it must be at least one, such as --drones 5,10,30")
    check_counts(seeds=seeds)
    scenarios = {name: swept_scenarios(params, scenario, name, values, dynamics) for name, values in fields.items()}
    variants = tuple(itertools.chain.from_iterable(scenarios.values()))
    job = Job(scenario=variants[0], dynamics=dynamics, variants=variants)
    settings = {"point": params._asdict(), "dynamics": dynamics, "seeds": seeds, "sweeps": dict(fields)}
    study = Study(verb="sweep", scenario=scenario, settings=settings)
    out = out or study.default_folder()
    number = itertools.count()
    found = []
    with kept_flights(study, out, job, workers, scheduler) as flights:
        for name, values in fields.items():
            own = [next(number) for _ in values]
            with flights_progress(name) as told:
                found.append(sweep(flights, params, name, values, variants=own, seeds=fresh_seeds(seeds), told=told))
            save(partial(sweep_figure, found[-1], _field_unit(name)), out / f"{name}.png")
        swept = {one.field: {"values": list(fields[one.field]), "fitness": one.fitness.tolist()} for one in found}
        content = {"point": point, "dynamics": dynamics, "seeds": list(fresh_seeds(seeds)), "sweeps": swept}
        text = json.dumps(content, indent=1) + "\n"
        with new_file(out / "sweeps.json") as place:
            place.write_text(text, encoding="utf-8")
    if as_json:
        print(text, end="")
        return 0
    console = Console()
    for one in found:
        console.print(rich_table(_means(one)))
    console.print(f"figures and JSON: {out}", highlight=False, soft_wrap=True)
    return 0


def _field_unit(name: str) -> str:
    return str(next(field.metadata["bounds"].unit for field in dataclasses.fields(Scenario) if field.name == name))


def _means(found: Sweep) -> Words:
    """Values down, fitnesses across."""
    pairs = zip(found.values, found.fitness.mean(axis=1), half_width(found.fitness, axis=1), strict=True)
    rows = [
        (f"{value:g}", *(f"{mean:.3f} ± {width:.3f}" for mean, width in zip(means, widths, strict=True)))
        for value, means, widths in pairs
    ]
    return Words(found.field, (found.field, *(f"F_{name}" for name in FITNESS_NAMES)), rows)


def _content(
    point: str, params: FlockingParams, indices: SobolIndices, along: OneAtATime, seeds: int
) -> dict[str, Any]:
    arrays = {name: _lists(values) for name, values in indices._asdict().items() if name != "points"}
    return {
        "fitnesses": list(FITNESS_NAMES),
        "parameters": list(FlockingParams._fields),
        "sobol": arrays | {"points": indices.points},
        "one_at_a_time": {
            "point": point,
            "params": params._asdict(),
            "seeds": list(fresh_seeds(seeds)),
            "values": along.values.tolist(),
            "fitness": along.fitness.tolist(),
        },
    }


def _lists(values: NDArray[np.float64]) -> list[list[float | None]]:
    return [[value if np.isfinite(value) else None for value in row] for row in values.tolist()]


def _table(title: str, values: NDArray[np.float64], widths: NDArray[np.float64]) -> Words:
    """Parameters down, fitnesses across."""
    rows = [
        (name, *(f"{value:.2f} ± {width:.2f}" for value, width in zip(values[:, k], widths[:, k], strict=True)))
        for k, name in enumerate(FlockingParams._fields)
    ]
    return Words(title, ("parameter", *(f"F_{name}" for name in FITNESS_NAMES)), rows)
