"""Agreement of point-mass flights with RobotSim, and of points A and B with the paper.

Run as `python -m tests.fidelity.robotsim` (`make fidelity`). The reference figures are of RobotSim
(github.com/csviragh/robotsim) on 15 points, 6 seeds each: 30 drones, 600 s, step 0.01 s.
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moflock_mj import Fitness, OrderParameters, Scenario, VasarhelyiParams, fly
from moflock_mj.metrics.fitness import fitness_of

REFERENCE = Path(__file__).parents[1] / "reference"
JUDGED = ("wall", "vel", "corr", "disc", "cluster")
MEAN_SQUARE_LIMIT = 1.6
F_LIMIT = {"F_1": 0.06, "F_2": 0.08}


class Comparison(NamedTuple):
    """One point, flown here and on RobotSim: z, the differences of means in standard errors of both sides; F, here
    minus there.
    """

    name: str
    z: dict[str, float]
    f_difference: dict[str, float]


def reference_points() -> dict[str, tuple[VasarhelyiParams, NDArray[np.float64]]]:
    """Each point with RobotSim's order parameters, (seeds, 6), in our order."""
    points = json.loads((REFERENCE / "robotsim.json").read_text())["points"]
    names = [f"phi_{name}" for name in OrderParameters._fields]
    return {
        name: (VasarhelyiParams(*point["x"]), np.array([[run[phi] for phi in names] for run in point["runs"]]))
        for name, point in points.items()
    }


def our_order_parameters(params: VasarhelyiParams, scenario: Scenario, seeds: range) -> NDArray[np.float64]:
    """Order parameters of point-mass flights: (seeds, 6)."""

    def one(seed: int) -> OrderParameters:
        return fly(params, scenario=scenario, dynamics="point_mass", seed=seed, keep_samples=False).order_parameters

    with ThreadPoolExecutor(2) as pool:
        return np.array(list(pool.map(one, seeds)))


def mean_fitness(order_parameters: NDArray[np.float64]) -> Fitness:
    """Fitness of each flight, averaged over flights."""
    each = fitness_of(OrderParameters(*order_parameters.T), Scenario())
    return Fitness(*(float(np.mean(values)) for values in each))


def compare(name: str, params: VasarhelyiParams, theirs: NDArray[np.float64], seeds: range) -> Comparison:
    """Fly one point and hold it against RobotSim."""
    ours = our_order_parameters(params, Scenario(step=0.01), seeds)
    difference = ours.mean(axis=0) - theirs.mean(axis=0)
    error = np.sqrt(ours.var(axis=0, ddof=1) / len(ours) + theirs.var(axis=0, ddof=1) / len(theirs))
    z = np.divide(difference, error, out=np.zeros_like(difference), where=error > 0)
    fitness, reference = mean_fitness(ours), mean_fitness(theirs)
    return Comparison(
        name,
        {phi: float(z[OrderParameters._fields.index(phi)]) for phi in JUDGED},
        {objective: getattr(fitness, objective) - getattr(reference, objective) for objective in F_LIMIT},
    )


def mean_squares(comparisons: list[Comparison]) -> dict[str, float]:
    """Mean square of z over the points, by order parameter; near 1 for simulators that agree."""
    return {phi: float(np.mean([c.z[phi] ** 2 for c in comparisons])) for phi in JUDGED}


def mean_differences(comparisons: list[Comparison]) -> dict[str, float]:
    """Mean absolute difference over the points, by objective."""
    return {f: float(np.mean([abs(c.f_difference[f]) for c in comparisons])) for f in F_LIMIT}


def paper_rows(seeds: range) -> list[tuple[str, str, float, float, float]]:
    """(point, objective, our mean, paper's mean, paper's standard deviation) with MOflock's start."""
    paper = json.loads((REFERENCE / "paper.json").read_text())["points"]
    scenario = Scenario(start="moflock")
    rows = []
    for name in ("A", "B"):
        fitness = mean_fitness(our_order_parameters(VasarhelyiParams(*paper[name]["x"]), scenario, seeds))
        for objective in F_LIMIT:
            mean, deviation = paper[name]["paper"][objective]
            rows.append((name, objective, getattr(fitness, objective), mean, deviation))
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12, help="flights of each point")
    parser.add_argument("--first-seed", type=int, default=1)
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    comparisons = []
    print("difference to RobotSim, in standard errors of both sides; then of the mean fitnesses")
    print(f"{'point':14}" + "".join(f"{phi:>9}" for phi in JUDGED) + "".join(f"{f:>9}" for f in F_LIMIT))
    for name, (params, theirs) in reference_points().items():
        comparison = compare(name, params, theirs, seeds)
        comparisons.append(comparison)
        cells = [*comparison.z.values(), *comparison.f_difference.values()]
        print(f"{name:14}" + "".join(f"{cell:9.2f}" for cell in cells), flush=True)
    squares, differences = mean_squares(comparisons), mean_differences(comparisons)
    cells = [*squares.values(), *differences.values()]
    print(f"{'mean square':14}" + "".join(f"{cell:9.3f}" for cell in cells) + "   (last two: mean absolute)")
    good = all(value <= MEAN_SQUARE_LIMIT for value in squares.values())
    good &= all(value < F_LIMIT[f] for f, value in differences.items())
    print(f"limits: {MEAN_SQUARE_LIMIT} each; {', '.join(f'{f} {limit}' for f, limit in F_LIMIT.items())}")
    print("\nMOflock's start, 20 seeds, against the paper's mean and standard deviation")
    for point, objective, ours, mean, deviation in paper_rows(range(1, 21)):
        within = abs(ours - mean) <= deviation
        good &= within
        print(
            f"{point} {objective}: {ours:.3f}, paper {mean:.3f} +- {deviation:.3f}: {'within' if within else 'OUTSIDE'}"
        )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
