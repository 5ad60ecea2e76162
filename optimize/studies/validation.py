"""Validation of the named points for the documentation: `make validation`, or `python -m optimize.studies.validation`.

The study writes `docs/validation.md` and its figure. All flights are stored in `logs/validation/` and are not repeated;
remove that folder to repeat them.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moflock_mj.analysis.identification import identify
from moflock_mj.files import new_file
from moflock_mj.scenario.effect_configs import PointMassConfig
from moflock_mj.scenario.scenario import Scenario
from optimize.analysis.statistics import half_width
from optimize.cli.console import TERMINAL, flights_progress
from optimize.evaluation.batch import FlownPoints, evaluate_batch
from optimize.evaluation.evaluation import FIGURE_NAMES, Job, search_scenario
from optimize.evaluation.executors import make_executor
from optimize.evaluation.objectives import PAPER
from optimize.reports import identification_tables
from optimize.reports.figures import save
from optimize.reports.tables import Words, markdown
from optimize.reports.validation_figures import fronts_figure
from optimize.reports.validation_page import render_validation_page, write
from optimize.validation.run import run_validation
from optimize.validation.validation import POINT_MASS, RIGID_BODY, SEEDS, Validation, make_settings

POINTS = ("A", "B", "model_optimum", "knee", "fast", "cohesive", "steady")

FAULT_SEEDS = 10
"""Number of the seeds on which each point flies each fault."""


def make_study(scenario: Scenario, logs: Path, docs: Path, *, seeds: int, fault_seeds: int, workers: int) -> Path:
    """Validate the named points, identify the airframe, and compare the calibrated point mass with both dynamics.

    Args:
        scenario: scenario of the flights.
        logs: directory of the validation; an existing one is resumed.
        docs: output folder for `validation.md` and its figure.
        seeds: number of seeds of each point.
        fault_seeds: number of seeds of each point with each of the standard faults.
        workers: number of processes.

    Returns:
        Path of the page.

    Raises:
        MoflockError: a flight fails, a file cannot be written, or the directory holds another validation.
    """
    found, logged = run_validation(
        logs, make_settings(scenario, POINTS, seeds, fault_seeds), workers=workers, logs=True, terminal=TERMINAL
    )
    write(found, logged, logs)
    identified = identify(scenario)
    calibrated = _calibrated(found, identified.response, workers)
    words = (*identification_tables.tables(identified), *calibration_tables(found, calibrated))
    sections = [f"## {table.title}\n\n{markdown(table.head, table.rows)}" for table in words]
    text = "\n\n".join(
        [
            render_validation_page(found, logged, "validation/fronts.png").rstrip(),
            "## Point mass of this airframe",
            "This page is written by `make validation`. `moflock identify` flies velocity steps with the rigid body "
            "and fits the point mass to them. The delay of the point mass is inside its velocity loop.",
            *sections,
        ]
    )
    with new_file(docs / "validation.md") as place:
        place.write_text(text + "\n", encoding="utf-8")
    save(lambda: fronts_figure(found), docs / "validation" / "fronts.png")
    return docs / "validation.md"


def calibration_tables(found: Validation, calibrated: FlownPoints) -> tuple[Words, Words]:
    """Tables of the effect of calibration on the objectives, and of velocity errors with both dynamics."""
    plain_values, body_values = (found.objectives[dynamics] for dynamics in (POINT_MASS, RIGID_BODY))
    fitted_values = PAPER.of_columns(calibrated.fitness)
    # Differences on the same seed do not contain the spread between the seeds.
    differences = (plain_values - body_values, fitted_values - body_values, fitted_values - plain_values)
    objectives = [
        (name, *(_with_error(difference[number, :, k]) for k in range(2) for difference in differences))
        for number, name in enumerate(found.names)
    ]
    gaps = ("point mass less rigid body", "calibrated less rigid body", "calibrated less point mass")
    head = [f"{name}: {what}" for name in PAPER.names for what in gaps]
    column = FIGURE_NAMES.index("velocity_error_rms")
    plain, body = (found.column("velocity_error_rms", dynamics).mean(axis=1) for dynamics in (POINT_MASS, RIGID_BODY))
    fitted = calibrated.figures[:, :, column].mean(axis=1)
    errors = [
        (name, *(f"{value[number]:.3f}" for value in (plain, fitted, body)), *_shares(plain, fitted, body, number))
        for number, name in enumerate(found.names)
    ]
    return (
        Words("Effect of calibration on the objectives, difference on the same seed", ("point", *head), objectives),
        Words(
            "Velocity error, m/s RMS",
            (
                "point",
                "point mass",
                "calibrated",
                "rigid body",
                "point mass less rigid body",
                "calibrated less rigid body",
            ),
            errors,
        ),
    )


def _with_error(values: NDArray[np.float64]) -> str:
    return f"{values.mean():+.3f} ± {float(half_width(values, axis=0)):.3f}"


def _shares(
    plain: NDArray[np.float64], fitted: NDArray[np.float64], body: NDArray[np.float64], number: int
) -> list[str]:
    return [f"{100 * (value[number] / body[number] - 1):+.1f} %" for value in (plain, fitted)]


def _calibrated(found: Validation, response: PointMassConfig, workers: int) -> FlownPoints:
    """Fly the same points and seeds as point masses with the response of the airframe."""
    settings = found.settings
    scenario = search_scenario(settings.scenario.replace(point_mass=response), "point_mass")
    points = list(settings.points.values())
    job = Job(scenario=scenario, dynamics="point_mass", policy=settings.policy)
    with make_executor(job, workers) as executor, flights_progress("calibrated point masses") as progress:
        return evaluate_batch(executor, points, [settings.seeds] * len(points), progress)


def main() -> None:
    """Read the arguments and run the study."""
    parser = argparse.ArgumentParser(description="Validate the named points and write docs/validation.md.")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--logs", type=Path, default=Path("logs/validation"))
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--fault-seeds", type=int, default=FAULT_SEEDS)
    parser.add_argument("--duration", type=float, default=Scenario().duration)
    arguments = parser.parse_args()
    scenario = Scenario(duration=arguments.duration)
    effort = {"seeds": arguments.seeds, "fault_seeds": arguments.fault_seeds, "workers": arguments.workers}
    print(make_study(scenario, arguments.logs, arguments.docs, **effort))


if __name__ == "__main__":
    main()
