"""Blueprint for Rerun: flock in 3D, curves of the metrics, and events.

The blueprint is the same for every log and stored as a file, so that logging does not require Rerun. `python -m
moflock_mj.log.rerun_blueprint` regenerates the file, for a newer Rerun or after a change here.
"""

from __future__ import annotations

import gzip
import tempfile
from pathlib import Path
from typing import Any

from moflock_mj.errors import RenderError
from moflock_mj.log.foxglove_layout import BLUEPRINT_FILE, CURVE_COLOURS, PLOTS, curve_label
from moflock_mj.log.schemas import Metrics

APPLICATION = "moflock"
"""Application id of the recordings to which Rerun applies the blueprint automatically."""


def write_blueprint(out: Path) -> None:
    """Write the blueprint, a .rbl file, with rerun-sdk.

    Raises:
        RenderError: rerun-sdk is not installed.
    """
    try:
        import rerun  # noqa: PLC0415 - an extra
        import rerun.blueprint as views  # noqa: PLC0415 - an extra
    except ImportError as problem:
        raise RenderError("rerun: rerun-sdk is not installed; pip install 'moflock-mj[rerun]'") from problem
    flock = views.Spatial3DView(
        origin="/",
        contents=["/swarm/points", "/arena", "/tf"],
        name="Flock",
        background=[18, 22, 28],
        # Negative radii are in pixels; a drone of true size would be invisible.
        overrides={"/swarm/points": rerun.Points3D.from_fields(radii=-5.0)},
        line_grid=views.LineGrid3D(visible=True, spacing=50.0),
    )
    events = views.TextLogView(origin="/log", name="Events")
    plots = [_plot(views, title, fields, limits) for title, fields, limits in PLOTS]
    views.Blueprint(
        views.Horizontal(
            views.Vertical(flock, events, row_shares=[4, 1]), views.Vertical(*plots), column_shares=[3, 2]
        ),
        views.TimePanel(state="collapsed", timeline="message_log_time", fps=10),
        collapse_panels=True,
    ).save(APPLICATION, out)


def _plot(views: Any, title: str, fields: tuple[str, ...], limits: tuple[float, float] | None) -> Any:
    """View with curves of fields of /metrics, which Rerun stores as one message."""
    import rerun  # noqa: PLC0415 - an extra
    from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping  # noqa: PLC0415 - an extra

    curves = [
        rerun.SeriesLines(names=curve_label(field), colors=[*bytes.fromhex(colour[1:])]).visualizer(
            mappings=[
                VisualizerComponentMapping(
                    target="Scalars:scalars",
                    source_kind=ComponentSourceKind.SourceComponent,
                    source_component=f"{Metrics.DESCRIPTOR.full_name}:message",
                    selector=f".{field}",
                )
            ]
        )
        for field, colour in zip(fields, CURVE_COLOURS, strict=False)
    ]
    axis = views.ScalarAxis(range=limits) if limits else None
    return views.TimeSeriesView(
        origin="/",
        contents=["/metrics"],
        name=title,
        axis_y=axis,
        plot_legend=views.PlotLegend(corner=views.Corner2D.RightBottom),
        overrides={"/metrics": curves},
    )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        write_blueprint(Path(folder) / "moflock.rbl")
        BLUEPRINT_FILE.write_bytes(gzip.compress((Path(folder) / "moflock.rbl").read_bytes(), mtime=0))
