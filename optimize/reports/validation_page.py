"""Tables, JSON and a Markdown page of a validation."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.policies.registry import values_of
from moflock_mj.files import new_file
from optimize.analysis.statistics import half_width
from optimize.evaluation.evaluation import FIGURE_NAMES
from optimize.evaluation.objectives import FITNESS_NAMES
from optimize.reports.figures import save
from optimize.reports.tables import Words, markdown
from optimize.reports.validation_figures import fronts_figure
from optimize.validation.validation import (
    DYNAMICS,
    POINT_MASS,
    RIGID_BODY,
    Validation,
)

FIGURE = "fronts.png"
"""File name of the figure, beside the page."""


_OBJECTIVES = ("F_1", "F_2")


def tables(validation: Validation) -> tuple[Words, ...]:
    """Tables of objectives, fitnesses, rigid-body figures, fronts and, if they were flown, faults."""
    words = (_objectives(validation), _fitnesses(validation), _bodies(validation), _fronts(validation))
    return (*words, _faults(validation)) if validation.faults else words


def render_validation_page(validation: Validation, logs: Mapping[str, Path], figure: str = FIGURE) -> str:
    """Render the page in Markdown.

    Args:
        validation: a finished validation.
        logs: log of the worst seed, by the name of the point.
        figure: path of the figure, relative to the page.
    """
    scenario, seeds = validation.settings.scenario, len(validation.settings.seeds)
    parts = [
        "# Points on rigid bodies",
        f"{scenario.drones} drones ({scenario.airframe}), {scenario.duration:g} s, {seeds} seeds, which are the same "
        "for all points and both dynamics. Values are means with 95 % confidence intervals. The gap is the mean "
        "difference between rigid body and point mass on the same seed.",
    ]
    for words in tables(validation):
        parts += [f"## {words.title}", markdown(words.head, words.rows)]
        if words.title.startswith("Rigid"):
            parts.append(LEGEND)
        if words.title == _FAULTS:
            parts.append(FAULT_LEGEND)
    parts += [
        f"![Fronts]({figure})",
        "## Verdicts",
        "\n".join(f"- {line}" for line in verdict_lines(validation, logs)),
    ]
    return "\n\n".join(parts) + "\n"


def verdict_lines(validation: Validation, logs: Mapping[str, Path]) -> list[str]:
    """Verdict of each point with its reason, and the command that replays the worst flight."""
    return [
        f"{name}: {verdict.name}: {verdict.reason}" + (f"; moflock replay {logs[name]}" if name in logs else "")
        for name, verdict in zip(validation.names, validation.verdicts, strict=True)
    ]


def to_json(validation: Validation, logs: Mapping[str, Path]) -> dict[str, Any]:
    """Results as JSON values."""
    settings, points = validation.settings, []
    for number, name in enumerate(validation.names):
        verdict, log = validation.verdicts[number], logs.get(name)
        points.append(
            {
                "name": name,
                "params": values_of(settings.points[name]),
                "verdict": verdict.name,
                "reason": verdict.reason,
                **{dynamics: _facts(validation, d, number) for d, dynamics in enumerate(DYNAMICS)},
                "gap": dict(zip(_OBJECTIVES, map(_mean, _gap(validation)[number].T), strict=True)),
                "worst_seed": validation.worst_seed(number),
                "log": str(log) if log else None,
            }
        )
    content = {"scenario": settings.scenario.to_dict(), "seeds": list(settings.seeds), "points": points}
    return content | ({"faults": _fault_facts(validation)} if validation.faults else {})


def dumps(content: Mapping[str, Any]) -> str:
    """JSON text; NaN and infinity are errors."""
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def _facts(validation: Validation, dynamics: int, number: int) -> dict[str, Any]:
    columns = zip(FITNESS_NAMES, validation.fitness[dynamics, number].T, strict=True)
    objectives = zip(_OBJECTIVES, validation.objectives[dynamics, number].T, strict=True)
    figures = {
        name: [float(value) for value in values]
        for name, values in zip(FIGURE_NAMES, validation.figures[dynamics, number].T, strict=True)
        if np.isfinite(values).all()
    }
    return {
        **{name: _mean(values) for name, values in objectives},
        "fitness": {name: _mean(values) for name, values in columns},
        "figures_of_each_flight": figures,
        "failed": int(validation.failed[dynamics, number]),
        "on_front": bool(validation.on_front[dynamics, number]),
    }


def _mean(values: NDArray[np.float64]) -> dict[str, float]:
    return {"mean": float(values.mean()), "half_width_95": float(half_width(values, axis=0))}


def _gap(validation: Validation) -> NDArray[np.float64]:
    """(P, S, 2), objectives of rigid bodies less those of point masses."""
    return np.asarray(validation.objectives[RIGID_BODY] - validation.objectives[POINT_MASS])


def _cells(values: NDArray[np.float64], digits: int = 3, sign: str = "") -> list[str]:
    """Format mean and half width over the first axis of (S, K)."""
    pairs = zip(values.mean(axis=0), half_width(values, axis=0), strict=True)
    return [f"{mean:{sign}.{digits}f} ± {width:.{digits}f}" for mean, width in pairs]


def _objectives(validation: Validation) -> Words:
    rows = []
    for number, name in enumerate(validation.names):
        point_mass, rigid_body = (_cells(validation.objectives[d, number]) for d in (POINT_MASS, RIGID_BODY))
        gaps = _cells(_gap(validation)[number], sign="+")
        columns = [cell for three in zip(point_mass, rigid_body, gaps, strict=True) for cell in three]
        rows.append((name, *columns, validation.verdicts[number].name))
    head = [f"{name} {label}" for name in _OBJECTIVES for label in ("point mass", "rigid body", "gap")]
    return Words("Objectives and verdicts", ("point", *head, "verdict"), rows)


def _fitnesses(validation: Validation) -> Words:
    rows = [
        (name, dynamics.replace("_", " "), *_cells(validation.fitness[d, number][:, : len(FITNESS_NAMES)]))
        for number, name in enumerate(validation.names)
        for d, dynamics in enumerate(DYNAMICS)
    ]
    return Words("All fitnesses", ("point", "dynamics", *(f"F_{name}" for name in FITNESS_NAMES)), rows)


def _bodies(validation: Validation) -> Words:
    separation, error = validation.column("separation_min"), validation.column("velocity_error_rms")
    point_masses = [validation.column(name, POINT_MASS) for name in ("separation_min", "velocity_error_rms")]
    columns = {
        "touched": _texts(validation.column("touched").mean(axis=1), 1),
        "lost": _texts(validation.column("lost").mean(axis=1), 1),
        "separation, m": _with_point_mass(separation.min(axis=1), point_masses[0].min(axis=1), 2),
        "tilt, deg": _texts(np.degrees(validation.column("tilt_max").max(axis=1)), 1),
        "at limit, %": _texts(100 * validation.column("saturated_share").mean(axis=1), 3),
        "velocity error, m/s": _with_point_mass(error.mean(axis=1), point_masses[1].mean(axis=1), 3),
        "altitude error, m": _texts(validation.column("altitude_error_rms").mean(axis=1), 3),
        "altitude error max, m": _texts(validation.column("altitude_error_max").max(axis=1), 2),
        "outside, m": _texts(validation.column("outside_max").max(axis=1), 2),
        "energy, J/m": _texts(validation.energy_per_metre().mean(axis=1), 1),
    }
    rows = [(name, *(column[number] for column in columns.values())) for number, name in enumerate(validation.names)]
    return Words("Rigid bodies (point masses in brackets)", ("point", *columns), rows)


LEGEND = (
    "Touched, lost: number of drones per flight. Separation: smallest value of all flights. Tilt, altitude error max, "
    "outside (distance outside the arena): largest values of all flights. At limit: share of time with a rotor at its "
    "limit. Velocity error, altitude error: RMS. Energy: of all rotors, per metre of path of all drones."
)
"""Legend of the table of rigid-body figures."""


_FAULTS = "Faults"


FAULT_LEGEND = (
    "For each point: number of rigid-body flights in which no drone was lost except the faulty one, and mean number of "
    "other drones that touched something. Each fault begins after a third of the flight; temporary faults last for "
    "another third. Verdicts: survived, no other drone was lost; unharmed, no other drone touched anything."
)
"""Legend of the table of faults."""


def _faults(validation: Validation) -> Words:
    flights = validation.settings.fault_seeds
    lost, touched = (validation.column(name)[:, :flights] for name in ("lost", "touched"))
    rows = [("none", "", *_fault_cells((lost == 0).sum(axis=1), flights, touched), "")]
    for trial in validation.faults:
        rows.append((trial.name, trial.text, *_fault_cells(trial.survived, flights, trial.touched), trial.verdict))
    return Words(_FAULTS, ("fault", "description", *validation.names, "verdict"), rows)


def _fault_cells(survived: NDArray[np.int64], flights: int, touched: NDArray[Any]) -> list[str]:
    pairs = zip(survived, touched.mean(axis=1), strict=True)
    return [f"{count} of {flights}, {mean:.1f} touched" for count, mean in pairs]


def _fault_facts(validation: Validation) -> dict[str, Any]:
    return {
        trial.name: {
            "verdict": trial.verdict,
            "points": {
                name: {
                    "flights": trial.lost.shape[1],
                    "survived": int(trial.survived[number]),
                    "others_lost": trial.lost[number].tolist(),
                    "others_touched": trial.touched[number].tolist(),
                    "F_1": trial.objectives[number, :, 0].tolist(),
                    "F_2": trial.objectives[number, :, 1].tolist(),
                }
                for number, name in enumerate(validation.names)
            },
        }
        for trial in validation.faults
    }


def _with_point_mass(bodies: NDArray[np.float64], point_masses: NDArray[np.float64], digits: int) -> list[str]:
    pairs = zip(_texts(bodies, digits), _texts(point_masses, digits), strict=True)
    return [f"{body} ({point_mass})" for body, point_mass in pairs]


def _texts(values: NDArray[np.float64], digits: int = 3) -> list[str]:
    return [f"{value:.{digits}f}" for value in values]


def _fronts(validation: Validation) -> Words:
    mean = validation.objectives.mean(axis=2)
    order = sorted(range(len(validation.names)), key=lambda number: -mean[RIGID_BODY, number, 0])
    rows = [
        (
            validation.names[number],
            *("on the front" if validation.on_front[d, number] else "dominated" for d in (POINT_MASS, RIGID_BODY)),
            validation.verdicts[number].name,
        )
        for number in order
    ]
    return Words("Fronts", ("point, by F_1 of rigid bodies", *map(_spaced, DYNAMICS), "verdict"), rows)


def _spaced(dynamics: str) -> str:
    return dynamics.replace("_", " ")


PAGE = "validation.md"


JSON = "validation.json"
"""Names of files in a validation's directory."""


def write(found: Validation, logs: Mapping[str, Path], path: Path) -> str:
    """Write page, figure and JSON into a directory; return the JSON text."""
    content = dumps(to_json(found, logs))
    for name, text in ((JSON, content), (PAGE, render_validation_page(found, logs))):
        with new_file(path / name) as place:
            place.write_text(text, encoding="utf-8")
    save(lambda: fronts_figure(found), path / FIGURE)
    return content
