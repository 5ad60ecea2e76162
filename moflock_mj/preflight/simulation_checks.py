"""Flights of the point on rigid bodies, in the very scenario that is to be flown, as part of a pre-flight check."""

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
"""Seeds that are flown unless told."""


def fly_trials(
    params: NamedTuple,
    scenario: Scenario,
    seeds: Sequence[int],
    *,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Flight]:
    """Fly a point on bodies, several seeds side by side; the flights' loops hold no interpreter lock.

    Args:
        params: the point.
        scenario: with its wind and its faults.
        seeds: one flight each.
        workers: threads; by default as many as there are processors.
        progress: told the share that is done.

    Raises:
        MoflockError: it cannot be flown.
    """
    done, broken_off = dict.fromkeys(seeds, 0.0), threading.Event()

    def one(seed: int) -> Flight:
        def told(flown: float, _: object) -> None:
            done[seed] = flown / scenario.duration

        return fly(
            params, scenario=scenario, dynamics="rigid_body", seed=seed, keep_samples=False, progress=told,
            stop=broken_off.is_set,
        )  # fmt: skip

    with concurrent.futures.ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        flights = [pool.submit(one, seed) for seed in seeds]
        try:
            while concurrent.futures.wait(flights, timeout=0.2).not_done:
                if progress:
                    progress(sum(done.values()) / len(done))
            return [flight.result() for flight in flights]
        finally:
            broken_off.set()
            pool.shutdown(cancel_futures=True)


def trial_items(flights: Sequence[Flight], scenario: Scenario) -> list[CheckItem]:
    """What the flights say, the worst of them against the scenario's limits; see `AcceptanceLimits`."""
    limits, airframe = scenario.verdict, load_airframe(scenario.airframe)
    bodies = [flight.body for flight in flights if flight.body]
    # Who falls by a scheduled fault is not held against the point.
    fallen = len({fault.drone for fault in scenario.faults if KINDS[fault.kind].falls})
    lost = max((body.lost for body in bodies), default=0)
    touching = sum(body.touched > 0 for body in bodies)
    least = limits.least_separation(2 * airframe.radius)
    separation = min((flight.motion.separation_min for flight in flights), default=np.inf)
    advice = "fly slower, in less wind or with fewer drones, or choose a safer point: moflock validate"
    worst = {
        "rotors at their limit": (100 * max(body.saturated_share for body in bodies), 100 * limits.saturated, "%"),
        "altitude error": (max(body.altitude_error_max for body in bodies), limits.altitude_error, "m"),
        "outside the arena": (max(flight.motion.outside_max for flight in flights), limits.outside, "m"),
    }
    return [
        check(
            "drones lost in simulation", FLOCK, good=lost <= fallen, value=float(lost),
            limit=f"{fallen} by the scenario's faults, in {len(flights)} flights", advice=advice,
        ),
        check(
            "flights with touches", FLOCK, good=touching == 0, value=float(touching), limit=f"none of {len(flights)}",
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
