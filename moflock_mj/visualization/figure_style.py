"""Style of all figures: settings of matplotlib, and colours."""

from __future__ import annotations

from typing import Any

# The colours of Okabe and Ito, which are distinct for every kind of colour blindness, without those faint on paper.
BLACK, ORANGE, GREEN, BLUE, RED, PINK = "#222222", "#e69f00", "#009e73", "#0072b2", "#d55e00", "#cc79a7"
GREY = "#8a8a8a"

FLIGHTS = ("#1e88e5", "#43a047")
"""Colours of two compared flights in figures, pages and videos; visible on white and on dark backgrounds."""

STYLE: dict[Any, Any] = {
    "font.size": 9,
    "font.family": "DejaVu Sans",
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "svg.hashsalt": "moflock",  # makes the file of a flight reproducible
}
