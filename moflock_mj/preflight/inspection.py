"""The vehicle part of a pre-flight check: query and observe the vehicles, then check each one and the whole flock.

Nothing is changed on a vehicle unless `LivePlan.fix` is set.
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
from moflock_mj.ground_station.flight_modes import ESTIMATOR_MESSAGES, INSPECTION_RATES, mode_name
from moflock_mj.ground_station.origin import find_origin
from moflock_mj.ground_station.piloting import PROFILES, FlightTask, profile_of, run_prearm_checks, set_mode
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
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
    correct_settings,
    layer_height,
    read_settings,
    requirements_of,
    return_altitude,
    settings_items,
)
from moflock_mj.scenario.scenario import Scenario

_WATCH = 6.0
"""Minimum time over which rates and losses are measured, s."""
_POLL = 0.5
_PREARM_AGAIN = 10.0
"""Interval of requests for the pre-arm checks, s."""
_CLOCKS = 1.0
"""Maximum difference between the vehicles' clocks, s."""
_POSITION_ID = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT


@dataclasses.dataclass(frozen=True, kw_only=True)
class LivePlan:
    """Plan of the vehicle checks.

    Attributes:
        scenario: scenario of the deployment.
        connections: addresses of the vehicles.
        count: number of vehicles; None for one on each link.
        origin: latitude and longitude of the arena's centre, degrees; None for the mean of the vehicles' homes.
        autopilot: autopilot that all vehicles must have, "ardupilot" or "px4"; None for either.
        fix: whether to correct parameters and fences.
        wait: time to wait for the estimators, s.
        timeout: time to wait for the vehicles, s.
        separation: minimum distance between two vehicles on the ground, m.
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
    """Result of the vehicle checks.

    Attributes:
        vehicles: the checked vehicles.
        items: all results except the batteries'.
        changes: changes made on vehicles.
        link_delay: one-way delay of the slowest link, s; 0 if none was measured.
        batteries: function that checks each battery against the energy of one drone's flight, J, or None.
    """

    vehicles: tuple[CheckedVehicle, ...]
    items: tuple[CheckItem, ...]
    changes: tuple[str, ...]
    link_delay: float
    batteries: Callable[[float | None], list[CheckItem]]


StatusCallback = Callable[[str], None]
"""Callback that receives a short description of the current step."""


def checked_vehicle(vehicle: RemoteVehicle) -> CheckedVehicle:
    """Identity of a vehicle, for a report."""
    version = vehicle.message("AUTOPILOT_VERSION")
    uid = "" if version is None else (bytes(version.uid2).hex() if any(version.uid2) else f"{version.uid:x}")
    return CheckedVehicle(system=vehicle.system, autopilot=profile_of(vehicle).name, where=vehicle.where, uid=uid)


async def inspect(plan: LivePlan, key: SigningKey | None, progress: StatusCallback = lambda _: None) -> Inspection:
    """Connect to all vehicles and check them.

    Raises:
        MoflockError: a vehicle is missing, two share a system id, one has another autopilot, or one rejects a change
            by `fix`.
    """
    progress("listening")
    async with vehicles_at(plan.connections, key, count=plan.count, timeout=plan.timeout) as (ground, vehicles):
        profiles = [profile_of(vehicle).name for vehicle in vehicles]
        for vehicle, profile in zip(vehicles, profiles, strict=True):
            if plan.autopilot not in (None, profile):
                raise LinkError(f"{vehicle}: autopilot is {profile}; it must be {plan.autopilot}")
        return await _Inspector(plan, ground, vehicles, profiles, progress).run()


class _Inspector:
    """Checks of the vehicles of one flock."""

    def __init__(
        self,
        plan: LivePlan,
        ground: GroundStation,
        vehicles: list[RemoteVehicle],
        profiles: list[str],
        progress: StatusCallback,
    ) -> None:
        self._plan = plan
        self._scenario = plan.scenario.replace(drones=len(vehicles))
        self._ground = ground
        self._vehicles = vehicles
        self._profiles = profiles
        self._progress = progress
        self._loop = asyncio.get_running_loop()
        self._positions: collections.Counter[int] = collections.Counter()
        self._clocks: dict[int, float] = {}
        self._changes: list[str] = []

    async def run(self) -> Inspection:
        """Run all checks."""
        self._progress("requesting telemetry")
        await asyncio.gather(*map(self._ask, self._vehicles, self._profiles))
        self._ground.observers.append(self._count)
        await self._until_ready()
        origin = self._origin()
        if origin is None:
            items = self._readiness(None, CheckResult.FAILURE)
            return self._inspection(items, [(None, 0.0)] * len(self._vehicles))
        # Positions that a vehicle could not send before its first fix must not count as a slow link.
        self._positions.clear()
        began = self._loop.time()
        self._progress("reading parameters and fences")
        settings = await self._settings(origin)
        watched = began + _WATCH - self._loop.time()
        if watched > 0:
            self._progress("measuring the links")
            await asyncio.sleep(watched)
        seconds = self._loop.time() - began
        self._ground.check_ids()
        items = self._readiness(origin, CheckResult.FAILURE)
        for number, (vehicle, profile) in enumerate(zip(self._vehicles, self._profiles, strict=True)):
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
        """Request messages and rates, since a real ArduPilot sends little but HEARTBEAT unasked."""
        rates = INSPECTION_RATES | {ESTIMATOR_MESSAGES[profile]: 2.0}
        rates[_POSITION_ID] = max(rates[_POSITION_ID], 2 / self._scenario.t_gps)
        await set_rates(vehicle, rates)
        for number in (mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, mavlink.MAVLINK_MSG_ID_HOME_POSITION):
            await request_message(vehicle, number, tries=2)
        if self._plan.fix and profile == "px4" and not vehicle.armed:
            await self._make_armable(vehicle)
        await run_prearm_checks(vehicle)

    async def _make_armable(self, vehicle: RemoteVehicle) -> None:
        """Set a PX4 on the ground to HOLD, the mode of a take-off, since its arming checks depend on its mode."""
        before, hold = vehicle.mode, PROFILES[vehicle.autopilot].modes[FlightTask.HOLD]
        if before not in PROFILES[vehicle.autopilot].taking_off:
            await set_mode(vehicle, hold)
            names = (mode_name(vehicle.autopilot, mode) for mode in (before, hold))
            self._changes.append(f"{about(vehicle)}: mode: {' -> '.join(names)}")

    async def _until_ready(self) -> None:
        """Wait while any check is RUNNING, at most `LivePlan.wait`."""
        requested = began = self._loop.time()
        while self._loop.time() < began + self._plan.wait:
            running = [
                item
                for item in self._readiness(self._origin(), CheckResult.RUNNING)
                if item.result is CheckResult.RUNNING
            ]
            if not running:
                return
            waiting = {item.about for item in running}
            self._progress(f"{len(waiting)} of {len(self._vehicles)} not ready: {running[0].about}: {running[0].name}")
            await asyncio.sleep(_POLL)
            if self._loop.time() - requested > _PREARM_AGAIN:
                requested = self._loop.time()
                await asyncio.gather(*map(self._ask_again, self._vehicles))

    async def _ask_again(self, vehicle: RemoteVehicle) -> None:
        await request_message(vehicle, mavlink.MAVLINK_MSG_ID_HOME_POSITION, tries=1)
        await run_prearm_checks(vehicle)

    def _readiness(self, origin: Origin | None, running: CheckResult) -> list[CheckItem]:
        """Readiness of all vehicles, with `running` as the result of unfinished checks."""
        items = [
            item
            for vehicle, profile in zip(self._vehicles, self._profiles, strict=True)
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

    async def _settings(self, origin: Origin) -> list[VehicleSettings]:
        """Read the settings of all vehicles, and correct them first if `fix` is set."""
        found = await self._read(origin)
        if not self._plan.fix:
            return found
        self._progress("correcting parameters and fences")
        flying = [vehicle for vehicle in self._vehicles if vehicle.armed or vehicle.landed is False]
        if flying:
            raise CommandError(f"fix: {flying[0]} is armed or in the air: nothing was changed on any vehicle")
        changes = await asyncio.gather(
            *(
                correct_settings(
                    vehicle, profile, self._requirements(number, origin), found[number], origin, self._scenario
                )
                for number, (vehicle, profile) in enumerate(zip(self._vehicles, self._profiles, strict=True))
            )
        )
        self._changes += itertools.chain.from_iterable(changes)
        return await self._read(origin)

    async def _read(self, origin: Origin) -> list[VehicleSettings]:
        return await asyncio.gather(
            *(
                read_settings(vehicle, profile, self._requirements(number, origin), origin)
                for number, (vehicle, profile) in enumerate(zip(self._vehicles, self._profiles, strict=True))
            )
        )

    def _flock(self, origin: Origin, settings: Sequence[VehicleSettings]) -> list[CheckItem]:
        """Checks of the whole flock."""
        places = {vehicle.system: place for vehicle in self._vehicles if (place := vehicle.position(origin))}
        arena, least = self._scenario.arena, self._plan.separation
        pairs = [
            (math.dist(a[:2], b[:2]), f"vehicles {one} and {other}")
            for (one, a), (other, b) in itertools.combinations(places.items(), 2)
        ]
        nearest, pair = min(pairs, default=(math.inf, ""))
        out = float(arena.distance_outside(list(places.values())).max()) if places else math.inf
        items = [
            check(
                "spacing on the ground", FLOCK, good=nearest >= least, value=float(nearest), unit="m",
                limit=f"at least {least:g} m", advice=f"move {pair} apart",
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
        known = sorted(height for height in heights if height is not None)
        gap = min((b - a for a, b in itertools.pairwise(known)), default=math.inf)
        least = 0.9 * layer_height(len(self._vehicles))
        return [
            check(
                "return altitudes staggered", FLOCK, good=len(known) == len(heights) and gap >= least, value=float(gap),
                unit="m", limit=f"at least {least:.2g} m apart",
                advice="returning vehicles would cross at one altitude: run preflight with --fix",
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
                    value=f"{len(offsets)} of {len(self._vehicles)} send the time",
                    advice="the vehicles' logs will not align: wait for their GPS",
                )
            ]  # fmt: skip
        spread = max(offsets) - min(offsets)
        return [
            check(
                "one clock", FLOCK, good=spread <= _CLOCKS, value=spread, unit="s", limit=f"within {_CLOCKS:g} s",
                advice="the vehicles' clocks differ: power-cycle the deviating vehicle under open sky",
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
            message = self._ground.vehicles[traffic.system].message("SYSTEM_TIME")
            if message is not None and message.time_unix_usec:
                self._clocks[traffic.system] = message.time_unix_usec / 1e6 - traffic.time
