"""The layout that shows a flight in Foxglove or Lichtblick: the flock in 3D, curves of its figures, and its events."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from moflock_mj.log.schemas import WORLD_FRAME
from moflock_mj.metrics.catalogue import METRICS

CURVE_COLOURS = ("#42a5f5", "#ffca28", "#66bb6a", "#e51c34", "#ab47bc", "#26c6da", "#ffffff")

PLOTS: tuple[tuple[str, tuple[str, ...], tuple[float, float] | None], ...] = (
    ("Objectives (larger is better)", ("F_1", "F_2", "F_product"), (0.0, 1.0)),
    ("The six fitnesses", tuple(metric.fitness_symbol for metric in METRICS), (0.0, 1.0)),
    ("Order parameters", ("phi_wall", "phi_vel", "phi_cluster", "phi_disc"), None),
    ("Correlation and collisions", ("phi_corr", "phi_coll"), None),
)
"""Of each plot its title, the fields of /metrics in it, and its bounds or None."""

LAYOUT_NAME, BLUEPRINT_NAME = "layout.json", "blueprint.rbl.gz"
"""The attachments for viewers: one for Foxglove and Lichtblick, one for Rerun, packed since it is mostly schemas."""

BLUEPRINT_FILE = Path(__file__).with_name(BLUEPRINT_NAME)
"""Rerun's blueprint, made by `rerun_blueprint`."""

_UNITS = {metric.symbol: metric.unit for metric in METRICS if metric.unit}


def viewer_layout(arena_width: float) -> bytes:
    """A layout as JSON, to be imported in Foxglove or Lichtblick.

    Args:
        arena_width: m, how much the camera sees.
    """
    plots = {f"Plot!{number}": _plot(*plot) for number, plot in enumerate(PLOTS)}
    first, second, third, fourth = plots
    panels = {
        "3D!flock": _flock_panel(arena_width),
        **plots,
        "RosOut!events": {"topicToRender": "/log", "searchTerms": [], "minLogLevel": 1},
    }
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 5},
        "layout": _split(
            "row",
            _split("column", "3D!flock", "RosOut!events", 78),
            _split(
                "column",
                _split("column", first, second),
                _split("column", third, fourth),
            ),
            62,
        ),
    }
    return json.dumps(layout, indent=1).encode()


def curve_label(field: str) -> str:
    """A field of /metrics with its unit."""
    return f"{field} [{_UNITS[field]}]" if field in _UNITS else field


def _split(direction: str, first: Any, second: Any, percentage: float = 50) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}


def _flock_panel(arena_width: float) -> dict[str, Any]:
    return {
        "cameraState": {
            "perspective": True,
            "distance": 1.2 * arena_width,
            "phi": 50.0,
            "thetaOffset": 30.0,
            "target": [0.0, 0.0, 0.0],
            "targetOffset": [0.0, 0.0, 0.0],
            "targetOrientation": [0.0, 0.0, 0.0, 1.0],
            "fovy": 45.0,
            "near": 0.1,
            "far": 20.0 * arena_width,
        },
        "followMode": "follow-none",
        "followTf": WORLD_FRAME,
        # The axes and names of all drones' frames would hide the flock.
        "scene": {"transforms": {"showLabel": False, "axisScale": 0.0, "editable": False}},
        "transforms": {},
        "topics": {
            "/swarm/points": {
                "visible": True,
                "colorMode": "rgba-fields",
                "pointShape": "circle",
                "pointSize": 8.0,
                "decayTime": 0.0,
            },
            "/scene": {"visible": True},
            # The same walls as dots, for viewers that draw no scene.
            "/arena": {"visible": False},
        },
        "layers": {},
    }


def _plot(title: str, fields: tuple[str, ...], limits: tuple[float, float] | None) -> dict[str, Any]:
    paths = [
        {
            "value": f"/metrics.{field}",
            "label": curve_label(field),
            "color": colour,
            "enabled": True,
            "timestampMethod": "receiveTime",
        }
        for field, colour in zip(fields, CURVE_COLOURS, strict=False)
    ]
    config: dict[str, Any] = {
        # Foxglove and Lichtblick each have a key of their own.
        "foxglovePanelTitle": title,
        "lichtblickPanelTitle": title,
        "paths": paths,
        "xAxisVal": "timestamp",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "xAxisLabel": "time, s",
        "isSynced": True,
        "sidebarDimension": 240,
    }
    if limits:
        config["minYValue"], config["maxYValue"] = limits
    return config
