"""What the identification of an airframe has shown, as tables, and JSON."""

from __future__ import annotations

import math
from typing import Any

from moflock_mj.analysis.identification import DIRECTIONS, STEP_SIZES, Identification
from optimize.reports.tables import Words


def tables(found: Identification) -> tuple[Words, ...]:
    """The response and how well it fits; the margins of the controller's loops."""
    response, step = found.response, found.step
    rows = [
        ("tau", f"{response.tau:.4g} s"),
        ("a_max", f"{response.a_max:.4g} m/s^2"),
        ("delay", f"{response.delay:.4g} s"),
        ("error of this point mass", f"{found.error_rms:.2g} m/s RMS, {found.error_max:.2g} m/s at most"),
        ("of the best one without a delay", f"{found.undelayed_rms:.2g} m/s RMS"),
        ("of the one that the scenario asks for", f"{found.asked_rms:.2g} m/s RMS"),
        ("bandwidth of the linear model", f"{found.linear.bandwidth:.3g} rad/s"),
        ("its error", f"{found.linear.error_rms:.2g} m/s RMS"),
        ("rise time, 10 to 90 %", f"{step.rise_time:.3g} s"),
        ("settling time, within 2 %", f"{step.settling_time:.3g} s"),
        ("overshoot", f"{step.overshoot:.2g} %"),
    ]
    margins = [
        (
            loop.loop,
            f"{loop.crossover:.3g}",
            f"{loop.gain_margin:.1f}" if math.isfinite(loop.gain_margin) else "any",
            f"{loop.phase_margin:.0f}",
            f"{1000 * loop.delay_margin:.0f}",
        )
        for loop in found.margins
    ]
    sizes = ", ".join(f"{size:g}" for size in STEP_SIZES)
    return (
        Words(f"{found.airframe}: steps of {sizes} m/s, back and to rest, in {DIRECTIONS} directions", ("", ""), rows),
        Words(
            "Loops as designed",
            ("loop", "crossover, rad/s", "gain margin, dB", "phase margin, deg", "delay margin, ms"),
            margins,
        ),
    )


def to_json(found: Identification) -> dict[str, Any]:
    """All figures as JSON values; an unbounded margin is null."""
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
