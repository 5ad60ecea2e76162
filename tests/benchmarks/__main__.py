"""Timings on one core: `make bench`. They are printed, not asserted."""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from moflock_mj import Scenario, fly, load_point
from moflock_mj.scenario import effect_configs
from moflock_mj.simulation.simulation import Simulation
from tests.support.cli import MOFLOCK

POINT = load_point("model_optimum")


def best_of(repeats: int, action: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """Shortest time of several repetitions, s, after one warm-up, which compiles."""
    action()
    times = []
    for _ in range(repeats):
        began = clock()
        action()
        times.append(clock() - began)
    return min(times)


def row(what: str, value: float, unit: str, remark: str = "") -> None:
    print(f"{what:58} {value:10.3f} {unit:8} {remark}", flush=True)


def point_mass_flights() -> None:
    for step, draft in ((0.1, 0.16), (0.01, 0.40)):
        scenario = Scenario(step=step)
        seconds = best_of(5, lambda s=scenario: fly(POINT, scenario=s, dynamics="point_mass", keep_samples=False))
        row(f"point mass, 30 drones, 600 s, step {step} s", seconds, "s", f"first draft {draft} s")


def bare_step(simulation: Simulation, snapshot: bytes, steps: int) -> float:
    """Duration of one call of mj_step alone from a state of the flight, s, with hover thrust and no torque."""
    body = simulation.body
    assert body is not None
    force = body.dynamics.state.qfrc_applied

    def steps_from_there() -> None:
        mujoco.mj_step(body.model, body.data, nstep=steps)

    times = []
    for _ in range(5):
        simulation.restore(snapshot)
        force[:] = 0
        force[:, 2] = body.dynamics.model.gains.mass * 9.81
        began = time.perf_counter()
        steps_from_there()
        times.append((time.perf_counter() - began) / steps)
    return min(times)


def flown(
    scenario: Scenario, snapshots: list[bytes] | None = None, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Duration of a rigid-body flight without its construction, s; `snapshots` receives its state at every tenth."""
    simulation = Simulation(POINT, scenario, "rigid_body", 1)
    seconds = 0.0
    while not simulation.finished:
        began = clock()
        simulation.run(5.0)
        seconds += clock() - began
        if snapshots is not None and simulation.interval % (simulation.components.schedule.intervals // 10) == 0:
            snapshots.append(simulation.snapshot())
    return seconds


def rigid_body_flights() -> None:
    scenario = Scenario()
    flown(scenario.replace(duration=1.0))
    seconds = min(flown(scenario) for _ in range(3))
    snapshots: list[bytes] = []
    flown(scenario, snapshots)
    start = Simulation(POINT, scenario, "rigid_body", 1)
    at_rest = bare_step(start, start.snapshot(), 4000)
    steps = scenario.duration / start.step
    bare = float(np.mean([bare_step(start, snapshot, 200) for snapshot in snapshots]))
    row("rigid body, 30 drones, 600 s, step 0.005 s", seconds, "s", f"{scenario.duration / seconds:.0f}x real time")
    row("  mj_step alone, same number of calls, in-flight states", bare * steps, "s")
    row("  flight / mj_step alone, in-flight states", seconds / bare / steps, "", "at most 1.25; first draft 1.5")
    row("  flight / mj_step alone, bodies at rest far apart", seconds / at_rest / steps, "")


def scaling() -> None:
    per_drone = {}
    for drones in (10, 30, 100, 300, 1000):
        side = 500 * (drones / 30) ** 0.5
        duration = max(2.0, round(600 / drones))
        scenario = Scenario(drones=drones, arena_side=side, duration=duration)
        per_drone[drones] = min(flown(scenario) for _ in range(3)) / (duration / 0.005) / drones * 1e6
        ratio = per_drone[drones] / per_drone[30] if drones >= 30 else float("nan")
        row(f"rigid body, step of one of {drones} drones", per_drone[drones], "us", f"{ratio:.2f} times that of 30")
    print("  (limit: 300 at most 1.6 times 30)")


def air_share() -> None:
    """CPU time with aerodynamic effects, battery and IMU, compared with none of them, in alternating flights."""
    scenario = Scenario(duration=200.0)
    sections = {name: kind() for name, kind in Scenario.sections().items()}
    sections["wind"] = effect_configs.WindConfig(speed=8.0, turbulence="light")
    flights = {"none": scenario, "all": scenario.replace(**sections)}
    flights |= {name: scenario.replace(**{name: section}) for name, section in sections.items()}
    seconds = dict.fromkeys(flights, float("inf"))
    for each in flights.values():
        flown(each.replace(duration=1.0))
    for _ in range(5):
        for name, each in flights.items():
            seconds[name] = min(seconds[name], flown(each, clock=time.thread_time))
    row("rigid body, 30 drones, 200 s, all effects off, CPU", seconds["none"], "s")
    for name in flights:
        limit = "at most 0.3" if name == "all" else ""
        row(f"  share of {name}", seconds[name] / seconds["none"] - 1, "", limit)


def log_share() -> None:
    scenario = Scenario()
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "flight.mcap"

        def logged() -> None:
            fly(POINT, scenario=scenario, log=log, keep_samples=False)

        without = best_of(3, lambda: fly(POINT, scenario=scenario, keep_samples=False), time.process_time)
        with_log = best_of(3, logged, time.process_time)
        row("rigid body, 30 drones, 600 s, without a log, CPU", without, "s")
        row("  with a log, CPU", with_log, "s", f"{log.stat().st_size / 1e6:.1f} MB")
        row("  relative cost of the log", (with_log - without) / without, "", "at most 0.1")


def start_up() -> None:
    def command(*arguments: str) -> None:
        subprocess.run([MOFLOCK, *arguments], check=True, capture_output=True)

    row("moflock --help", best_of(5, lambda: command("--help")), "s", "under 0.5")
    seconds = best_of(3, lambda: command("fly", "--duration", "1", "--log", "none"))
    row("moflock fly --duration 1, from the cache", seconds, "s", "under 3")


def main() -> None:
    with contextlib.suppress(AttributeError, OSError):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    print(f"MuJoCo {mujoco.__version__}, NumPy {np.__version__}; one core; shortest of several runs\n")
    for group in (point_mass_flights, rigid_body_flights, scaling, air_share, log_share, start_up):
        group()


if __name__ == "__main__":
    main()
