"""Preparation before arming: message rates, home positions, and conditions that forbid a take-off."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence

from moflock_mj.deployment.member import Member
from moflock_mj.deployment.watchdogs import Watchdogs
from moflock_mj.errors import DeploymentError
from moflock_mj.ground_station.commands import request_message, set_rates
from moflock_mj.ground_station.flight_modes import DEPLOYMENT_RATES
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.mavlink.dialect import SIMULATED, mavlink
from moflock_mj.scenario.scenario import Scenario

_PX4_SIMULATED = int.from_bytes(b"ONIDLATI", "little")
"""AUTOPILOT_VERSION.uid of a PX4 built for simulation with system id 1 (part of SIMULATIONID0000); others follow."""


_NEEDED = (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,)
"""Messages whose rate is required for a flight."""


_FIX_TIMEOUT = 5.0
"""Time to wait for the first position, s."""


_POLL = 0.1


_AWAY_MAX = 10_000.0
"""Distance from the origin, m, beyond which a vehicle's position indicates a wrong origin."""


async def prepare(vehicles: Sequence[RemoteVehicle]) -> None:
    """Request the messages that a deployment requires from all vehicles.

    Raises:
        DeploymentError: a vehicle does not send a required message, or has no position or home.
    """
    await asyncio.gather(*(_prepare(vehicle) for vehicle in vehicles))


async def _prepare(vehicle: RemoteVehicle) -> None:
    refused = await set_rates(vehicle, DEPLOYMENT_RATES)
    if set(refused) & set(_NEEDED):
        raise DeploymentError(f"{vehicle}: does not send GLOBAL_POSITION_INT at the requested rate")
    for number in (mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, mavlink.MAVLINK_MSG_ID_HOME_POSITION):
        await request_message(vehicle, number)
    deadline = asyncio.get_running_loop().time() + _FIX_TIMEOUT
    while vehicle.fix is None or vehicle.home() is None:
        if asyncio.get_running_loop().time() > deadline:
            missing = "position" if vehicle.fix is None else "home"
            raise DeploymentError(f"{vehicle}: has no {missing} yet; wait for its GPS")
        await asyncio.sleep(_POLL)


async def require_simulated(vehicles: Sequence[RemoteVehicle]) -> None:
    """Refuse vehicles that could be real, since a rehearsal skips the pre-flight report.

    A simulated vehicle is on this machine and identifies itself: by a mark in the AUTOPILOT_VERSION of `moflock fleet`
    and PX4's simulation, or by SIMSTATE, which ArduPilot sends only from its simulator.

    Raises:
        DeploymentError: a vehicle could be real.
    """
    for vehicle in vehicles:
        if not vehicle.is_local:
            raise DeploymentError(f"rehearse: {vehicle} is not on this machine: it needs a pre-flight report")
    for vehicle, simulated in zip(vehicles, await asyncio.gather(*map(_is_simulated, vehicles)), strict=True):
        if not simulated:
            raise DeploymentError(f"rehearse: {vehicle} does not identify as simulated: it needs a pre-flight report")


async def _is_simulated(vehicle: RemoteVehicle) -> bool:
    version = vehicle.message("AUTOPILOT_VERSION")
    if version is not None and (
        tuple(version.middleware_custom_version) == SIMULATED or version.uid == _PX4_SIMULATED + vehicle.system - 1
    ):
        return True
    ardupilot = vehicle.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    return ardupilot and await request_message(vehicle, mavlink.MAVLINK_MSG_ID_SIMSTATE, tries=2) is not None


def check_start(members: Sequence[Member], scenario: Scenario, watchdogs: Watchdogs) -> None:
    """Refuse vehicles that must not take off, whatever the report says.

    Raises:
        DeploymentError: a vehicle is armed, in the air, outside the arena, low on battery, or too close to another.
    """
    arena = scenario.arena
    for member in members:
        vehicle, (x, y, _) = member.vehicle, member.position
        if vehicle.armed or vehicle.landed is False:
            raise DeploymentError(f"{vehicle}: is armed or in the air; it must be disarmed and on the ground")
        if arena.distance_outside((x, y)) > 0:
            where = f"{x:.0f}, {y:.0f} m" if max(abs(x), abs(y)) < _AWAY_MAX else "far away"
            raise DeploymentError(f"{vehicle}: stands outside the {arena.title} ({where} from its centre)")
        if vehicle.battery is not None and vehicle.battery < watchdogs.battery.limit:
            share = f"{100 * vehicle.battery:.0f} %"
            raise DeploymentError(
                f"{vehicle}: battery at {share}; it must be over {100 * watchdogs.battery.limit:.0f} %"
            )
    for place, member in enumerate(members):
        for other in members[:place]:
            apart = math.dist(member.position[:2], other.position[:2])
            if apart < watchdogs.separation.limit:
                raise DeploymentError(
                    f"vehicles {other.system} and {member.system} stand {apart:.1f} m apart; it must be at least "
                    f"{watchdogs.separation.limit:g} m"
                )
