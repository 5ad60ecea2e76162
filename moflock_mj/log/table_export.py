"""Export of a flight's samples as a table with a row per drone and time, in CSV or Parquet."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from controllers.policies.registry import spec_of, values_of
from moflock_mj.errors import RenderError
from moflock_mj.files import new_file
from moflock_mj.metrics.order_parameters import CLOSE, OUTSIDE, TOUCHED
from moflock_mj.simulation.results import AnyFlight, kept_samples

if TYPE_CHECKING:
    from pyarrow import Table

# Names include the unit, because CSV has no metadata.
COLUMNS = {
    "t_s": ("s", "simulated time"),
    "drone": ("1", "number of the drone, from 0"),
    "x_m": ("m", "position, world"),
    "y_m": ("m", "position, world"),
    "z_m": ("m", "position, world, up"),
    "vx_m_s": ("m/s", "velocity, world"),
    "vy_m_s": ("m/s", "velocity, world"),
    "vz_m_s": ("m/s", "velocity, world, up"),
    "desired_vx_m_s": ("m/s", "commanded velocity, world"),
    "desired_vy_m_s": ("m/s", "commanded velocity, world"),
    "outside": ("1", "true if beyond a wall of the arena"),
    "close": ("1", "true if closer than r_coll to another drone"),
    "touched": ("1", "true if it has touched another drone or the ground"),
}
"""Columns of the table: name, unit, meaning."""


def export_csv(flight: AnyFlight, out: str | os.PathLike[str]) -> None:
    """Write a flight's samples as CSV, with a header line.

    Raises:
        RenderError: no samples, pyarrow is not installed, or the file cannot be written.
    """
    table = sample_table(flight)
    from pyarrow import csv  # noqa: PLC0415 - an extra

    with new_file(out) as place:
        csv.write_csv(table, place)


def export_parquet(flight: AnyFlight, out: str | os.PathLike[str]) -> None:
    """Write a flight's samples as Parquet; column metadata contain units, file metadata the inputs of the flight.

    Raises:
        RenderError: no samples, pyarrow is not installed, or the file cannot be written.
    """
    table = sample_table(flight)
    from pyarrow import parquet  # noqa: PLC0415 - an extra

    with new_file(out) as place:
        parquet.write_table(table, place, compression="zstd")


def sample_table(flight: AnyFlight) -> Table:
    """Create a table of a flight's samples with `COLUMNS`, ordered by time, then drone.

    Raises:
        RenderError: no samples, or pyarrow is not installed.
    """
    arrow = _pyarrow()
    samples = kept_samples(flight)
    times, drones = samples.status.shape
    flags = samples.status.reshape(-1)
    values = [
        np.repeat(samples.t, drones),
        np.tile(np.arange(drones, dtype=np.int32), times),
        *samples.position.reshape(-1, 3).T,
        *samples.velocity.reshape(-1, 3).T,
        *samples.desired_velocity.reshape(-1, 2).T,
        *((flags & flag) > 0 for flag in (OUTSIDE, CLOSE, TOUCHED)),
    ]
    arrays = [arrow.array(np.ascontiguousarray(column)) for column in values]
    fields = [
        arrow.field(name, array.type, nullable=False, metadata={"unit": unit, "description": meaning})
        for (name, (unit, meaning)), array in zip(COLUMNS.items(), arrays, strict=True)
    ]
    return arrow.Table.from_arrays(arrays, schema=arrow.schema(fields, metadata=_conditions(flight)))


def _conditions(flight: AnyFlight) -> dict[str, str]:
    """Inputs of the flight, for repetition, and its fitness."""
    return {
        "scenario": flight.scenario.to_toml(),
        "policy": spec_of(flight.params).name,
        "parameters": json.dumps(values_of(flight.params)),
        "dynamics": flight.dynamics,
        "seed": str(flight.seed),
        "fitness": json.dumps(flight.fitness._asdict()),
    }


def _pyarrow() -> Any:
    try:
        import pyarrow  # noqa: PLC0415 - an extra
    except ImportError as problem:
        raise RenderError("tables: pyarrow is not installed; pip install 'moflock-mj[tables]'") from problem
    return pyarrow
