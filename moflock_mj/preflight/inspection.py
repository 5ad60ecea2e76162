"""The live part of a pre-flight check: vehicles on their links are asked, watched, and graded one by one and together.

Nothing is changed on them unless that is asked for.
"""

from __future__ import annotations

import asyncio
import collections
import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence

from moflock_mj.errors import CommandError, LinkError
from moflock_mj.ground_station.commands import request_message, set_rates
from moflock_mj.ground_station.origin import find_origin
from moflock_mj.ground_station.piloting import PROFILES, FlightTask, profile_of, run_prearm_checks, set_mode
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle, mode_name
from moflock_mj.ground_station.station import GroundStation, Traffic, vehicles_at
from moflock_mj.mavlink.addresses import Connection
from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.mavlink.frames import Origin
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.preflight.report import CheckedVehicle
from moflock_mj.preflight.required_parameters import FlightRequirements
from moflock_mj.preflight.results import FLOCK, CheckItem, CheckResult, check
from moflock_mj.preflight.vehicle_checks import about, battery_item, link_items, readiness
from moflock_mj.preflight.vehicle_settings import (
    VehicleSettings,
    layer_height,
    put_right,
    read_settings,
    requirements_of,
    return_altitude,
    settings_items,
)
from moflock_mj.scenario.scenario import Scenario

RATES = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
}
"""Hz, at the least: 2 / t_gps for positions."""
_ESTIMATOR = {
    "ardupilot": mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    "px4": mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
}
_WATCH = 6.0
"""s, over which rates and losses are taken at the least."""
_LOOK = 0.5
_PREARM_AGAIN = 10.0
"""s, after which a vehicle is asked again why it would not arm."""
_CLOCKS = 1.0
"""s, by which the vehicles' clocks may differ."""
_POSITION_ID = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT


@dataclasses.dataclass(frozen=True, kw_only=True)
class LivePlan:
    """What is looked at.

    Attributes:
        scenario: to be flown.
        connections: where the vehicles are.
        count: how many they are; None: one on each link.
        origin: latitude and longitude of the arena's middle; None: the mean of the vehicles' homes.
        autopilot: what all must be, "ardupilot" or "px4"; None: either.
        fix: whether to put right what is wrong.
        wait: s, for estimators to become ready.
        timeout: s, for vehicles to be heard.
        separation: m, least distance of two vehicles on the ground.
    """

    scenario: Scenario
    connections: Sequence[Connection]
    count: int | None = None
    origin: tuple[float, float] | None = None
    autopilot: str | None = None
    fix: bool = False
    wait: float = 60.0
    timeout: float = 10.0
    separation: float = 3.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Inspection:
    """What was seen.

    Attributes:
        vehicles: that were there.
        items: all grades but the batteries'.
        changes: what was put right.
        link_delay: s, one way, of the slowest link; 0 if none was measured.
        batteries: grades each battery by the energy, J, that one drone takes, or None.
    """

    vehicles: tuple[CheckedVehicle, ...]
    items: tuple[CheckItem, ...]
    changes: tuple[str, ...]
    link_delay: float
    batteries: Callable[[float | None], list[CheckItem]]


StatusCallback = Callable[[str], None]
"""Told in a few words what is being done."""


def checked_vehicle(vehicle: RemoteVehicle) -> CheckedVehicle:
    """Who a vehicle is, for a report."""
    version = vehicle.message("AUTOPILOT_VERSION")
    uid = "" if version is None else (bytes(version.uid2).hex() if any(version.uid2) else f"{version.uid:x}")
    return CheckedVehicle(system=vehicle.system, autopilot=profile_of(vehicle).name, where=vehicle.where, uid=uid)


async def inspect(plan: LivePlan, key: SigningKey | None, told: StatusCallback = lambda _: None) -> Inspection:
    """Look at all vehicles.

    Raises:
        MoflockError: they are not all there, two share an id, one is of another autopilot, or does not take what
            `fix` sets.
    """
    told("listening")
    async with vehicles_at(plan.connections, key, count=plan.count, timeout=plan.timeout) as (ground, vehicles):
        profiles = [profile_of(vehicle).name for vehicle in vehicles]
        for vehicle, profile in zip(vehicles, profiles, strict=True):
            if plan.autopilot not in (None, profile):
                raise LinkError(f"{vehicle}: autopilot is {profile}; it must be {plan.autopilot}")
        return await _Inspector(plan, ground, vehicles, profiles, told).look()


class _Inspector:
    """Goes round the vehicles of one flock."""

    def __init__(
        self,
        plan: LivePlan,
        ground: GroundStation,
        vehicles: list[RemoteVehicle],
        profiles: list[str],
        told: StatusCallback,
    ) -> None:
        self._plan = plan
        self._scenario = plan.scenario.replace(drones=len(vehicles))
        self._ground = ground
        self._vehicles = vehicles
        self._styles = profiles
        self._told = told
        self._loop = asyncio.get_running_loop()
        self._positions: collections.Counter[int] = collections.Counter()
        self._clocks: dict[int, float] = {}
        self._changes: list[str] = []

    async def look(self) -> Inspection:
        """All of it, one after the other."""
        self._told("asking for telemetry")
        await asyncio.gather(*map(self._ask, self._vehicles, self._styles))
        self._ground.observers.append(self._count)
        await self._until_ready()
        origin = self._origin()
        if origin is None:
            items = self._readiness(None, CheckResult.FAILURE)
            return self._inspection(items, [(None, 0.0)] * len(self._vehicles))
        # A vehicle that still had no position when it was first asked sent none; that is not its link's fault.
        self._positions.clear()
        began = self._loop.time()
        self._told("reading parameters and fences")
        settings = await self._settle(origin)
        watched = began + _WATCH - self._loop.time()
        if watched > 0:
            self._told("watching the links")
            await asyncio.sleep(watched)
        seconds = self._loop.time() - began
        self._ground.check_ids()
        items = self._readiness(origin, CheckResult.FAILURE)
        for number, (vehicle, profile) in enumerate(zip(self._vehicles, self._styles, strict=True)):
            items += link_items(vehicle, self._scenario, self._positions[vehicle.system] / seconds)
            items += settings_items(
                vehicle, profile, self._requirements(number, origin), settings[number], self._scenario
            )
        items += self._flock(origin, settings)
        return self._inspection(items, [(found.capacity, found.low) for found in settings])

    def _inspection(self, items: list[CheckItem], packs: Sequence[tuple[float | None, float]]) -> Inspection:
        trips = [vehicle.link.round_trip for vehicle in self._vehicles]
        vehicles = self._vehicles
        return Inspection(
            vehicles=tuple(map(checked_vehicle, vehicles)),
            items=tuple(items),
            changes=tuple(self._changes),
            link_delay=max((trip / 2 for trip in trips if math.isfinite(trip)), default=0.0),
            batteries=lambda energy: [
                battery_item(vehicle, capacity, energy, low=low)
                for vehicle, (capacity, low) in zip(vehicles, packs, strict=True)
            ],
        )

    async def _ask(self, vehicle: RemoteVehicle, profile: str) -> None:
        """A real ArduPilot sends little but HEARTBEAT until it is asked."""
        rates = RATES | {_ESTIMATOR[profile]: 2.0}
        rates[_POSITION_ID] = max(rates[_POSITION_ID], 2 / self._scenario.t_gps)
        await set_rates(vehicle, rates)
        for number in (mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, mavlink.MAVLINK_MSG_ID_HOME_POSITION):
            await request_message(vehicle, number, tries=2)
        if self._plan.fix and profile == "px4" and not vehicle.armed:
            await self._make_armable(vehicle)
        await run_prearm_checks(vehicle)

    async def _make_armable(self, vehicle: RemoteVehicle) -> None:
        """Let a PX4 on the ground hold, as a take-off begins: it judges for its present mode whether it would arm."""
        before, hold = vehicle.mode, PROFILES[vehicle.autopilot].modes[FlightTask.HOLD]
        if before not in PROFILES[vehicle.autopilot].taking_off:
            await set_mode(vehicle, hold)
            names = (mode_name(vehicle.autopilot, mode) for mode in (before, hold))
            self._changes.append(f"{about(vehicle)}: mode: {' -> '.join(names)}")

    async def _until_ready(self) -> None:
        """Wait while anything is RUNNING, at most as long as the plan allows."""
        asked = began = self._loop.time()
        while self._loop.time() < began + self._plan.wait:
            running = [
                item
                for item in self._readiness(self._origin(), CheckResult.RUNNING)
                if item.result is CheckResult.RUNNING
            ]
            if not running:
                return
            who = {item.about for item in running}
            self._told(f"{len(who)} of {len(self._vehicles)} not ready: {running[0].about}: {running[0].name}")
            await asyncio.sleep(_LOOK)
            if self._loop.time() - asked > _PREARM_AGAIN:
                asked = self._loop.time()
                await asyncio.gather(*map(self._ask_again, self._vehicles))

    async def _ask_again(self, vehicle: RemoteVehicle) -> None:
        await request_message(vehicle, mavlink.MAVLINK_MSG_ID_HOME_POSITION, tries=1)
        await run_prearm_checks(vehicle)

    def _readiness(self, origin: Origin | None, running: CheckResult) -> list[CheckItem]:
        """The vehicles' items; what still runs gets the grade `running`."""
        items = [
            item
            for vehicle, profile in zip(self._vehicles, self._styles, strict=True)
            for item in readiness(vehicle, profile, origin, self._scenario)
        ]
        return [
            item.model_copy(update={"result": running}) if item.result is CheckResult.RUNNING else item
            for item in items
        ]

    def _origin(self) -> Origin | None:
        known = all(vehicle.home() is not None for vehicle in self._vehicles)
        return find_origin(self._vehicles, self._plan.origin) if known else None

    def _requirements(self, number: int, origin: Origin) -> FlightRequirements:
        return requirements_of(self._vehicles[number], number, len(self._vehicles), origin, self._scenario)

    async def _settle(self, origin: Origin) -> list[VehicleSettings]:
        """Settings of all, after they were put right if that is wished."""
        found = await self._read(origin)
        if not self._plan.fix:
            return found
        self._told("putting parameters and fences right")
        flying = [vehicle for vehicle in self._vehicles if vehicle.armed or vehicle.landed is False]
        if flying:
            raise CommandError(f"fix: {flying[0]} is armed or flies: nothing was changed on any vehicle")
        changes = await asyncio.gather(
            *(
                put_right(vehicle, profile, self._requirements(number, origin), found[number], origin, self._scenario)
                for number, (vehicle, profile) in enumerate(zip(self._vehicles, self._styles, strict=True))
            )
        )
        self._changes += itertools.chain.from_iterable(changes)
        return await self._read(origin)

    async def _read(self, origin: Origin) -> list[VehicleSettings]:
        return await asyncio.gather(
            *(
                read_settings(vehicle, profile, self._requirements(number, origin), origin)
                for number, (vehicle, profile) in enumerate(zip(self._vehicles, self._styles, strict=True))
            )
        )

    def _flock(self, origin: Origin, settings: Sequence[VehicleSettings]) -> list[CheckItem]:
        """What only the whole flock shows."""
        places = {vehicle.system: place for vehicle in self._vehicles if (place := vehicle.position(origin))}
        arena, least = self._scenario.arena, self._plan.separation
        pairs = [
            (math.dist(a[:2], b[:2]), f"vehicles {one} and {other}")
            for (one, a), (other, b) in itertools.combinations(places.items(), 2)
        ]
        nearest, who = min(pairs, default=(math.inf, ""))
        out = float(arena.distance_outside(list(places.values())).max()) if places else math.inf
        items = [
            check(
                "spacing on the ground", FLOCK, good=nearest >= least, value=float(nearest), unit="m",
                limit=f"at least {least:g} m", advice=f"move {who} apart",
            ),
            check(
                "all in the arena", FLOCK, good=out <= 0, value=max(out, 0.0), unit="m",
                limit=f"0 m outside the {arena.title}",
                advice="move the vehicles, or the arena with --origin",
            ),
        ]  # fmt: skip
        return [*items, *self._layers(settings), *self._one_clock()]

    def _layers(self, settings: Sequence[VehicleSettings]) -> list[CheckItem]:
        if len(self._vehicles) < 2:
            return []
        heights = [return_altitude(found) for found in settings]
        told = sorted(height for height in heights if height is not None)
        gap = min((b - a for a, b in itertools.pairwise(told)), default=math.inf)
        least = 0.9 * layer_height(len(self._vehicles))
        return [
            check(
                "return altitudes staggered", FLOCK, good=len(told) == len(heights) and gap >= least, value=float(gap),
                unit="m", limit=f"at least {least:.2g} m apart",
                advice="vehicles that return cross each other's way at one height: run preflight with --fix",
            )
        ]  # fmt: skip

    def _one_clock(self) -> list[CheckItem]:
        offsets = list(self._clocks.values())
        if len(self._vehicles) < 2:
            return []
        if len(offsets) < len(self._vehicles):
            return [
                CheckItem(
                    name="one clock", about=FLOCK, result=CheckResult.WARNING, limit="SYSTEM_TIME of all",
                    value=f"{len(offsets)} of {len(self._vehicles)} tell the time",
                    advice="logs of the vehicles will not line up: let their GPS settle",
                )
            ]  # fmt: skip
        spread = max(offsets) - min(offsets)
        return [
            check(
                "one clock", FLOCK, good=spread <= _CLOCKS, value=spread, unit="s", limit=f"within {_CLOCKS:g} s",
                advice="one has another time than the others: switch it off and on under a free sky",
                otherwise=CheckResult.WARNING,
            )
        ]  # fmt: skip

    def _count(self, traffic: Traffic) -> None:
        if traffic.is_sent:
            return
        number = int.from_bytes(traffic.packet[7:10], "little")
        if number == _POSITION_ID:
            self._positions[traffic.system] += 1
        elif number == mavlink.MAVLINK_MSG_ID_SYSTEM_TIME:
            told = self._ground.vehicles[traffic.system].message("SYSTEM_TIME")
            if told is not None and told.time_unix_usec:
                self._clocks[traffic.system] = told.time_unix_usec / 1e6 - traffic.time
