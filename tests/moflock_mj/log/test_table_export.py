"""The exported tables: every number of the samples, with its unit."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from moflock_mj import Flight, Scenario, fly, load_point
from moflock_mj.errors import RenderError
from moflock_mj.log.table_export import COLUMNS, export_csv, export_parquet
from moflock_mj.metrics.order_parameters import OUTSIDE

parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed: the extra `tables`")


@pytest.fixture(scope="module")
def flight() -> Flight:
    scenario = Scenario(drones=4, duration=20.0, arena_side=60.0, start_spacing=5.0)
    return fly(load_point("B"), scenario=scenario, dynamics="point_mass")


def test_parquet_holds_every_sample_bit_by_bit(flight: Flight, tmp_path: Path) -> None:
    export_parquet(flight, tmp_path / "a.parquet")
    table = parquet.read_table(tmp_path / "a.parquet")
    samples = flight.samples
    times = samples.t.size
    column = {name: table[name].to_numpy().reshape(times, 4) for name in COLUMNS}
    assert (column["t_s"] == samples.t[:, None]).all()
    assert (column["drone"] == np.arange(4)).all()
    for axis, name in enumerate("xyz"):
        assert (column[f"{name}_m"] == samples.position[..., axis]).all()
        assert (column[f"v{name}_m_s"] == samples.velocity[..., axis]).all()
    for axis, name in enumerate("xy"):
        assert (column[f"desired_v{name}_m_s"] == samples.desired_velocity[..., axis]).all()
    assert (column["outside"] == ((samples.status & OUTSIDE) > 0)).all()


def test_parquet_says_what_its_columns_are(flight: Flight, tmp_path: Path) -> None:
    export_parquet(flight, tmp_path / "a.parquet")
    schema = parquet.read_schema(tmp_path / "a.parquet")
    assert {field.name: field.metadata[b"unit"].decode() for field in schema if field.name in COLUMNS} == {
        name: unit for name, (unit, _) in COLUMNS.items()
    }
    assert schema.metadata[b"seed"] == b"1"
    assert json.loads(schema.metadata[b"parameters"]) == flight.params._asdict()
    assert Scenario.from_toml(schema.metadata[b"scenario"].decode()) == flight.scenario


def test_csv_reads_back_exactly(flight: Flight, tmp_path: Path) -> None:
    export_csv(flight, tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == list(COLUMNS)
    assert len(rows) == flight.samples.status.size
    y = np.array([float(row["y_m"]) for row in rows]).reshape(-1, 4)
    assert (y == flight.samples.position[..., 1]).all()
    assert {row["touched"] for row in rows} == {"false"}


def test_a_file_that_cannot_be_written_leaves_nothing(flight: Flight, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for export in (export_csv, export_parquet):
        with pytest.raises(RenderError, match=r"file/a: "):
            export(flight, tmp_path / "file" / "a")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
