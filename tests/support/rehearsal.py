"""Complete deployments with a fleet, in simulated time and without sockets: a minute of flight takes a few seconds."""

from __future__ import annotations

import asyncio
import dataclasses

import numpy as np

from moflock_mj import load_point
from moflock_mj.deployment.deployment import DeployPlan, InterruptHandler, deploy
from moflock_mj.scenario.scenario import Scenario
from moflock_mj.simulated_vehicles.vehicle_faults import VehicleFault
from tests.support import simulated_time
from tests.support.ground_station import fleet_of
from tests.support.simulated_time import Wires, connections_to, flying

SCENARIO = Scenario(
    drones=5, arena_side=200.0, duration=30.0, altitude=10.0, t_del=0.2, sigma_outer=0.0, sigma_inner=0.0
)
"""Small scenario without disturbances; the arena is the fence."""

SMALL = Scenario(
    drones=4, arena_side=140.0, duration=20.0, altitude=5.0, t_del=0.2, v_flock=4.0, v_max=4.0, sigma_outer=0.0,
    sigma_inner=0.0,
)  # fmt: skip


@dataclasses.dataclass
class Truth:
    """True states of the fleet, independent of telemetry."""

    position: np.ndarray
    """(T, N, 3), m, world, at each step."""
    armed: np.ndarray
    """(T, N), whether a vehicle is armed."""

    @property
    def flying(self):
        return self.position[..., 2] > 2.0

    def nearest(self):
        """Smallest distance between two flying vehicles, m."""
        place = np.where(self.flying[..., None], self.position, np.nan)
        away = np.linalg.norm(place[:, :, None] - place[:, None], axis=-1)
        away[:, np.arange(place.shape[1]), np.arange(place.shape[1])] = np.nan
        return float(np.nanmin(away))

    def farthest(self):
        """Largest |x| or |y| of any vehicle, m."""
        return float(np.abs(self.position[..., :2]).max())


def rehearse(
    scenario=SCENARIO,
    *,
    autopilot="ardupilot",
    faults=(),
    point="knee",
    parameters=None,
    story=None,
    fleet=None,
    wanted=None,
    **plan,
):
    """Deploy a point with a fleet; return the result of the deployment, the true states, and the fleet.

    Args:
        scenario: scenario of the fleet and of the deployment.
        autopilot: autopilot of the fleet.
        faults: faults of vehicles, as texts.
        point: name of the point.
        parameters: parameters to set on each vehicle before the deployment.
        story: coroutine function of (interrupt handler, fleet) that runs concurrently; or None.
        fleet: further fields of the fleet's plan.
        wanted: autopilot that the deployment requires.
        plan: further fields of the deployment's plan.
    """
    flown = fleet_of(
        autopilot, vehicles=scenario.drones, scenario=scenario,
        faults=[VehicleFault.from_text(text) for text in faults], **(fleet or {}),
    )  # fmt: skip
    for station in flown.stations:
        for name, value in (parameters or {}).items():
            station.vehicle.parameters.set_value(name, value)
    places, armed = [], []

    def watch():
        places.append(flown.bodies.qpos[:, :3].copy())
        armed.append([station.vehicle.armed for station in flown.stations])

    async def play():
        interrupts = InterruptHandler()
        task = DeployPlan(
            params=load_point(point), scenario=scenario, connections=connections_to(flown), rehearse=True,
            **{"interval": 0.5, "autopilot": wanted, **plan},
        )  # fmt: skip
        async with flying(flown, watch):
            concurrent = asyncio.create_task(story(interrupts, flown)) if story else None
            try:
                return await deploy(task, None, interrupts)
            finally:
                if concurrent:
                    concurrent.cancel()

    with Wires().used():
        deployed = simulated_time.run(play())
    return deployed, Truth(np.array(places), np.array(armed)), flown
