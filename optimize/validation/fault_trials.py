"""Trials of points under the standard faults: losses other than the faulty drone."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from moflock_mj.scenario.faults import KINDS, FaultConfig
from moflock_mj.scenario.scenario import Scenario
from optimize.evaluation.evaluation import FIGURE_NAMES, Evaluation
from optimize.evaluation.objectives import PAPER

if TYPE_CHECKING:
    from moflock_mj.scenario.scenario import Scenario


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class FaultTrial:
    """Results of P points under one fault, as rigid bodies, in S flights each.

    Attributes:
        name: name of the fault.
        text: description of the fault.
        lost: (P, S), lost drones, without the one that the fault itself brings down; all drones if a flight failed.
        touched: (P, S), drones that touched another drone or the ground, counted in the same way.
        objectives: (P, S, 2), F_1 and F_2.
    """

    name: str
    text: str
    lost: NDArray[np.int64]
    touched: NDArray[np.int64]
    objectives: NDArray[np.float64]

    @property
    def survived(self) -> NDArray[np.int64]:
        """(P,), number of flights in which no drone was lost except the faulty one."""
        return np.asarray((self.lost == 0).sum(axis=1))

    @property
    def verdict(self) -> str:
        """Verdict over all flights: "unharmed" (no other drone touched anything), "survived" or "not survived"."""
        if self.lost.any():
            return "not survived"
        return "survived" if self.touched.any() else "unharmed"


def fault_trials(
    faults: Mapping[str, Scenario], flown: Sequence[Evaluation], *, points: int, seeds: int
) -> tuple[FaultTrial, ...]:
    """Results of the trials, one per fault.

    Args:
        faults: the scenario with each fault, by the name of the fault.
        flown: evaluations of one flight each, ordered by fault, then by point, then by seed.
        points: P, number of points.
        seeds: S, number of flights of each point with each fault.
    """
    shape, trials = (points, seeds), []
    for number, (name, scenario) in enumerate(faults.items()):
        some = flown[number * math.prod(shape) : (number + 1) * math.prod(shape)]
        (fault,) = scenario.faults[-1:]
        lost, touched = (
            np.array([_or_all(scenario, evaluation.figures[0, FIGURE_NAMES.index(figure)]) for evaluation in some])
            for figure in ("lost", "touched")
        )
        own = int(KINDS[fault.kind].falls)
        trials.append(
            FaultTrial(
                name=name,
                text=fault.describe(),
                lost=np.maximum(lost - own, 0).reshape(shape),
                touched=np.maximum(touched - own, 0).reshape(shape),
                objectives=PAPER.of_columns(np.array([evaluation.fitness[0] for evaluation in some])).reshape(
                    *shape, 2
                ),
            )
        )
    return tuple(trials)


def _or_all(scenario: Scenario, drones: float) -> int:
    """Number of drones; all drones of the scenario if the flight failed (NaN)."""
    return int(drones) if math.isfinite(drones) else scenario.drones


def standard_faults(scenario: Scenario) -> dict[str, Scenario]:
    """Scenarios with each of the faults that a flock should survive, by the name of the fault.

    Each fault begins after a third of the flight, when the flock has formed. A temporary fault lasts for another third;
    a damaged rotor and a power failure are permanent. The faults affect drone 0, as all drones are alike; packet loss
    affects all drones, and a blocked receiver one drone or all. Point masses do not support `rotor_failure`.
    """
    at = scenario.duration / 3
    temporary = functools.partial(FaultConfig, at=at, duration=at)
    faults = {
        "rotor_failure": FaultConfig(kind="rotor_failure", at=at, drone=0, rotor=0, effectiveness=0.5),
        "gps_loss": temporary(kind="gps_loss", drone=0),
        "gps_jump": temporary(kind="gps_jump", drone=0, jump=(10.0, 0.0)),
        "cannot_receive": temporary(kind="cannot_receive", drone=0),
        "cannot_receive_all": temporary(kind="cannot_receive"),
        "link_loss": temporary(kind="link_loss", share=0.5),
        "cannot_transmit": temporary(kind="cannot_transmit", drone=0),
        "power_off": FaultConfig(kind="power_off", at=at, drone=0),
    }
    return {name: scenario.replace(faults=(fault,)) for name, fault in faults.items()}
