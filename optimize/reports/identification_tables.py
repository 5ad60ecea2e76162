"""Tables and JSON of an identification of an airframe."""

from __future__ import annotations

import math
from typing import Any

from moflock_mj.analysis.identification import DIRECTIONS, STEP_SIZES, Identification
from optimize.reports.tables import Words


def tables(found: Identification) -> tuple[Words, ...]:
    """Tables of the fitted response with its errors, and of the margins of the control loops."""
    response, step = found.response, found.step
    rows = [
        ("tau", f"{response.tau:.4g} s"),
        ("a_max", f"{response.a_max:.4g} m/s^2"),
        ("delay", f"{response.delay:.4g} s"),
        ("velocity error of this point mass", f"{found.error_rms:.2g} m/s RMS, {found.error_max:.2g} m/s at most"),
        ("error of the best point mass without delay", f"{found.undelayed_rms:.2g} m/s RMS"),
        ("error of the scenario's point mass", f"{found.asked_rms:.2g} m/s RMS"),
        ("bandwidth of the linear model", f"{found.linear.bandwidth:.3g} rad/s"),
        ("error of the linear model", f"{found.linear.error_rms:.2g} m/s RMS"),
        ("rise time, 10 to 90 %", f"{step.rise_time:.3g} s"),
        ("settling time, within 2 %", f"{step.settling_time:.3g} s"),
        ("overshoot", f"{step.overshoot:.2g} %"),
    ]
    margins = [
        (
            loop.loop,
            f"{loop.crossover:.3g}",
            f"{loop.gain_margin:.1f}" if math.isfinite(loop.gain_margin) else "unbounded",
            f"{loop.phase_margin:.0f}",
            f"{1000 * loop.delay_margin:.0f}",
        )
        for loop in found.margins
    ]
    sizes = ", ".join(f"{size:g}" for size in STEP_SIZES)
    return (
        Words(
            f"{found.airframe}: velocity steps of {sizes} m/s, reversed and to rest, in {DIRECTIONS} directions",
            ("", ""),
            rows,
        ),
        Words(
            "Designed control loops",
            ("loop", "crossover, rad/s", "gain margin, dB", "phase margin, deg", "delay margin, ms"),
            margins,
        ),
    )


def to_json(found: Identification) -> dict[str, Any]:
    """Results as JSON values; an unbounded margin is null."""
    margins = [vars(loop) for loop in found.margins]
    return {
        **found._asdict(),
        "response": {"tau": found.response.tau, "a_max": found.response.a_max, "delay": found.response.delay},
        "linear": found.linear._asdict(),
        "step": found.step._asdict(),
        "margins": [
            {name: value if isinstance(value, str) or math.isfinite(value) else None for name, value in loop.items()}
            for loop in margins
        ],
    }
