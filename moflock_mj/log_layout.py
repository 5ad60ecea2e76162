"""The layout that shows a flight in Foxglove or Lichtblick: the flock in 3D, curves of its figures, and its events."""

from __future__ import annotations

import json
from typing import Any

from moflock_mj.log_schemas import FITNESS_FIELDS, WORLD_FRAME

_COLOURS = ("#42a5f5", "#ffca28", "#66bb6a", "#e51c34", "#ab47bc", "#26c6da", "#ffffff")
_UNITS = {
    "phi_wall": "m",
    "phi_vel": "m/s",
    "phi_coll": "share of pairs",
    "phi_disc": "drones",
    "phi_cluster": "neighbours",
}


def viewer_layout(arena_side: float) -> bytes:
    """A layout as JSON, to be imported in Foxglove or Lichtblick.

    Args:
        arena_side: m, how much the camera sees.
    """
    parts = FITNESS_FIELDS[:6]
    panels = {
        "3D!flock": _flock_panel(arena_side),
        "Plot!objectives": _plot("Objectives (larger is better)", ("F_1", "F_2", "F_product"), (0.0, 1.0)),
        "Plot!fitness": _plot("The six fitnesses", parts, (0.0, 1.0)),
        "Plot!order": _plot("Order parameters", ("phi_wall", "phi_vel", "phi_cluster", "phi_disc")),
        "Plot!small": _plot("Correlation and collisions", ("phi_corr", "phi_coll")),
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
                _split("column", "Plot!objectives", "Plot!fitness"),
                _split("column", "Plot!order", "Plot!small"),
            ),
            62,
        ),
    }
    return json.dumps(layout, indent=1).encode()


def _split(direction: str, first: Any, second: Any, percentage: float = 50) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}


def _flock_panel(arena_side: float) -> dict[str, Any]:
    return {
        "cameraState": {
            "perspective": True,
            "distance": 1.2 * arena_side,
            "phi": 50.0,
            "thetaOffset": 30.0,
            "target": [0.0, 0.0, 0.0],
            "targetOffset": [0.0, 0.0, 0.0],
            "targetOrientation": [0.0, 0.0, 0.0, 1.0],
            "fovy": 45.0,
            "near": 0.1,
            "far": 20.0 * arena_side,
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
        },
        "layers": {},
    }


def _plot(title: str, fields: tuple[str, ...], limits: tuple[float, float] | None = None) -> dict[str, Any]:
    paths = [
        {
            "value": f"/metrics.{field}",
            "label": f"{field} [{_UNITS[field]}]" if field in _UNITS else field,
            "color": colour,
            "enabled": True,
            "timestampMethod": "receiveTime",
        }
        for field, colour in zip(fields, _COLOURS, strict=False)
    ]
    config: dict[str, Any] = {
        "foxglovePanelTitle": title,
        "title": title,
        "paths": paths,
        "xAxisVal": "timestamp",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "isSynced": True,
        "sidebarDimension": 240,
    }
    if limits:
        config["minYValue"], config["maxYValue"] = limits
    return config
