"""The simulated part of a pre-flight check: rigid-body flights of the point in the scenario of the deployment."""

from __future__ import annotations

import concurrent.futures
import os
import threading
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from moflock_mj.dynamics.airframe_models import load_airframe
from moflock_mj.flight import fly
from moflock_mj.preflight.results import FLOCK, CheckItem, CheckResult, check
from moflock_mj.scenario.faults import KINDS
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulation.results import Flight

FLIGHTS = 10
"""Default number of flights."""


def fly_trials(
    params: NamedTuple,
    scenario: Scenario,
    seeds: Sequence[int],
    *,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Flight]:
    """Fly a point on rigid bodies, with several seeds in parallel threads; the flight loop releases the GIL.

    Args:
        params: the point.
        scenario: scenario, with its wind and its faults.
        seeds: seeds, one for each flight.
        workers: number of threads; None for one per processor.
        progress: callback that receives the completed share, from 0 to 1.

    Raises:
        MoflockError: the point cannot be flown.
    """
    done, cancelled = dict.fromkeys(seeds, 0.0), threading.Event()

    def fly_seed(seed: int) -> Flight:
        def report(flown: float, _: object) -> None:
            done[seed] = flown / scenario.duration

        return fly(
            params, scenario=scenario, dynamics="rigid_body", seed=seed, keep_samples=False, progress=report,
            stop=cancelled.is_set,
        )  # fmt: skip

    with concurrent.futures.ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        flights = [pool.submit(fly_seed, seed) for seed in seeds]
        try:
            while concurrent.futures.wait(flights, timeout=0.2).not_done:
                if progress:
                    progress(sum(done.values()) / len(done))
            return [flight.result() for flight in flights]
        finally:
            cancelled.set()
            pool.shutdown(cancel_futures=True)


def trial_items(flights: Sequence[Flight], scenario: Scenario) -> list[CheckItem]:
    """Check the worst of the flights against the scenario's `AcceptanceLimits`."""
    limits, airframe = scenario.verdict, load_airframe(scenario.airframe)
    bodies = [flight.body for flight in flights if flight.body]
    # Drones that fall because of a scheduled fault do not count against the point.
    fallen = len({fault.drone for fault in scenario.faults if KINDS[fault.kind].falls})
    lost = max((body.lost for body in bodies), default=0)
    touching = sum(body.touched > 0 for body in bodies)
    least = limits.least_separation(2 * airframe.radius)
    separation = min((flight.motion.separation_min for flight in flights), default=np.inf)
    advice = "fly slower, in less wind or with fewer drones, or choose a safer point: moflock validate"
    worst = {
        "rotor saturation": (100 * max(body.saturated_share for body in bodies), 100 * limits.saturated, "%"),
        "altitude error": (max(body.altitude_error_max for body in bodies), limits.altitude_error, "m"),
        "outside the arena": (max(flight.motion.outside_max for flight in flights), limits.outside, "m"),
    }
    return [
        check(
            "drones lost in simulation", FLOCK, good=lost <= fallen, value=float(lost),
            limit=f"at most {fallen}, by the scenario's faults, in each of {len(flights)} flights", advice=advice,
        ),
        check(
            "flights with contacts", FLOCK, good=touching == 0, value=float(touching), limit=f"none of {len(flights)}",
            advice=advice,
            otherwise=CheckResult.FAILURE if touching > limits.touched_flights * len(flights) else CheckResult.WARNING,
        ),
        check(
            "smallest separation in simulation", FLOCK, good=bool(separation >= least), value=float(separation),
            limit=f"at least {least:.3g} m", unit="m", advice=advice,
        ),
        *(
            check(
                f"{name} in simulation", FLOCK, good=value <= limit, value=float(value),
                limit=f"at most {limit:g} {unit}", unit=unit, advice=advice,
            )
            for name, (value, limit, unit) in worst.items()
        ),
    ]  # fmt: skip
