"""How the house's figures look: matplotlib's settings and colours."""

from __future__ import annotations

from typing import Any

# Of Okabe and Ito's colours, which stay apart for every kind of colour blindness, those that are not faint on paper.
BLACK, ORANGE, GREEN, BLUE, RED, PINK = "#222222", "#e69f00", "#009e73", "#0072b2", "#d55e00", "#cc79a7"
GREY = "#8a8a8a"

FLIGHTS = ("#1e88e5", "#43a047")
"""Of two flights that are compared, in pictures, pages and videos; they show on white and on a dark ground."""

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
    "svg.hashsalt": "moflock",  # so that the same flight gives the same file
}
