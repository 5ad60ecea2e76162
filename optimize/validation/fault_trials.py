"""How points bear the standard faults: what is lost besides the drone at fault."""

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
    """How P points have borne a fault, on bodies, in S flights each.

    Attributes:
        name: of the fault.
        text: what it is.
        lost: (P, S), drones lost that the fault itself had not brought down; all, in a flight that failed.
        touched: (P, S), drones that touched another one or the ground, counted in the same way.
        objectives: (P, S, 2), F_1 and F_2.
    """

    name: str
    text: str
    lost: NDArray[np.int64]
    touched: NDArray[np.int64]
    objectives: NDArray[np.float64]

    @property
    def survived(self) -> NDArray[np.int64]:
        """(P,), flights in which nothing was lost but the drone at fault."""
        return np.asarray((self.lost == 0).sum(axis=1))

    @property
    def verdict(self) -> str:
        """Of all flights: "unharmed" if no other drone touched anything, "survived" if none was lost."""
        if self.lost.any():
            return "not survived"
        return "survived" if self.touched.any() else "unharmed"


def fault_trials(
    faults: Mapping[str, Scenario], flown: Sequence[Evaluation], *, points: int, seeds: int
) -> tuple[FaultTrial, ...]:
    """How the faults were borne.

    Args:
        faults: the scenario with each of them, by name.
        flown: one flight each, in the order of the faults, then of the points.
        points: P.
        seeds: S.
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
    """A number of drones; all of them where a flight failed."""
    return int(drones) if math.isfinite(drones) else scenario.drones


def standard_faults(scenario: Scenario) -> dict[str, Scenario]:
    """The set of faults that a flock should survive: the scenario with each kind of fault alone, by name.

    Each begins after a third of the flight, when the flock has formed, and one that may end lasts another third, but
    for the rotor, which stays damaged. It befalls drone 0, since all are alike; packet loss befalls all, and blackout
    one drone or all. Point masses refuse `rotor_failure`.
    """
    at = scenario.duration / 3
    passing = functools.partial(FaultConfig, at=at, duration=at)
    faults = {
        "rotor_failure": FaultConfig(kind="rotor_failure", at=at, drone=0, rotor=0, effectiveness=0.5),
        "gps_loss": passing(kind="gps_loss", drone=0),
        "gps_jump": passing(kind="gps_jump", drone=0, jump=(10.0, 0.0)),
        "cannot_receive": passing(kind="cannot_receive", drone=0),
        "cannot_receive_all": passing(kind="cannot_receive"),
        "link_loss": passing(kind="link_loss", share=0.5),
        "cannot_transmit": passing(kind="cannot_transmit", drone=0),
        "power_off": FaultConfig(kind="power_off", at=at, drone=0),
    }
    return {name: scenario.replace(faults=(fault,)) for name, fault in faults.items()}
