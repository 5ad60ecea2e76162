"""Deployments on the loopback interface, compared with simulations: `python -m tests.benchmarks.deploy`.

The results are printed, not asserted. Targets for 10 vehicles, 120 s: jitter of setpoints below 10 ms and delay from
telemetry to setpoint below 50 ms (99th percentiles). Target for 30 vehicles, 60 s: less than one core.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from moflock_mj import Scenario, fly, load_point
from tests.support.cli import MOFLOCK

BASE_PORT = 15900
SEEDS = range(1, 9)
RUNS = ((10, 250.0, 120.0, "px4"), (10, 250.0, 120.0, "ardupilot"), (30, 400.0, 60.0, "px4"))


def rehearse(scenario: Scenario, autopilot: str, folder: Path) -> tuple[dict[str, object], float]:
    """Deploy with a fleet; return the JSON of the deployment and its CPU time, s."""
    (folder / "scenario.toml").write_text(scenario.to_toml())
    drones = scenario.drones
    fleet = subprocess.Popen(
        [
            MOFLOCK, "fleet", "--vehicles", str(drones), "--autopilot", autopilot, "--base-port", str(BASE_PORT),
            "--scenario", folder / "scenario.toml", "--spacing", "12", "--boot", "1", "--json",
        ],
        stdout=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    assert fleet.stdout is not None
    fleet.stdout.readline()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        done = subprocess.run(
            [
                MOFLOCK, "deploy", "knee", "--vehicles", f"udp:127.0.0.1:{BASE_PORT}-{BASE_PORT + drones - 1}",
                "--scenario", folder / "scenario.toml", "--rehearse", "--json", "--log", folder / "deployed.mcap",
                "--interval", "0.3",
            ],
            stdout=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    finally:
        fleet.terminate()
        fleet.wait()
    return json.loads(done.stdout), after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    point = load_point("knee")
    for drones, side, duration, autopilot in RUNS:
        scenario = Scenario(drones=drones, arena_side=side, duration=duration, warm_up=20.0, altitude=10.0, t_del=0.0)
        flown = np.array([fly(point, scenario=scenario, seed=seed).order_parameters for seed in SEEDS])
        with tempfile.TemporaryDirectory() as folder:
            report, cpu = rehearse(scenario, autopilot, Path(folder))
        seconds = max(event["time"] for event in report["events"])  # type: ignore[attr-defined]
        load = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
        print(f"{drones} vehicles as {autopilot}, {duration:g} s; {load}")
        print(f"  {report['latency']}")
        share = f"CPU {cpu / seconds:.0%} of a core, start included"
        print(f"  {share}; nearest {report['separation_min']:.1f} m; error: {report['error']}")
        for place, (name, value) in enumerate(report["order_parameters"].items()):  # type: ignore[attr-defined]
            low, high = flown[:, place].min(), flown[:, place].max()
            print(f"  phi_{name:8} {value:8.4f}   fly, {len(SEEDS)} seeds: {low:8.4f} to {high:8.4f}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
