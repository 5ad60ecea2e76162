"""A vehicle's parameters and fence: read them, check them, and correct them on request."""

from __future__ import annotations

import asyncio
import dataclasses
import math
import types

import numpy as np

from moflock_mj.errors import CommandError
from moflock_mj.ground_station.commands import FenceItem, download_fence, read_parameter, set_parameter, upload_fence
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.mavlink.dialect import mavlink
from moflock_mj.mavlink.fence import Circle, FenceError, Polygon, breaches, read_fence
from moflock_mj.mavlink.frames import Origin
from moflock_mj.mavlink.parameters import Parameter
from moflock_mj.preflight.required_parameters import (
    RETURN_ALTITUDE,
    FlightRequirements,
    RequiredParameter,
    Spellings,
    required_parameters,
)
from moflock_mj.preflight.results import CheckItem, CheckResult, check
from moflock_mj.preflight.vehicle_checks import about
from moflock_mj.scenario.scenario import Scenario

FENCE_MARGIN = 20.0
"""Distance from the arena's walls to a vehicle's own fence, m; it acts after the deployment's fence watchdog."""
_ROOF = 10.0
"""Distance from a vehicle's highest altitude to the top of its fence, m."""
_LAYERS, _LAYER = 90.0, 3.0
"""Range of the return altitudes of a flock, and maximum difference between two neighbouring ones, m."""
_TRIES = 2
_CAPACITY = {"ardupilot": "BATT_CAPACITY", "px4": "BAT1_CAPACITY"}
_LOW = {"ardupilot": "BATT_LOW_MAH", "px4": "BAT_LOW_THR"}
_GRID = 25
"""Number of points along each side of the arena at which the fence is evaluated."""
_FIX = "run preflight with --fix, or set it yourself"


@dataclasses.dataclass(frozen=True, kw_only=True)
class VehicleSettings:
    """Settings of a vehicle.

    Attributes:
        values: values of its parameters, by name.
        shapes: shapes of its fence, world; None if the fence is invalid or cannot be read.
        capacity: capacity of its battery, mAh; None if unknown.
        low: share of charge at which its own failsafe acts; 0 if unknown, or by voltage only.
    """

    values: dict[str, float]
    shapes: tuple[Polygon | Circle, ...] | None
    capacity: float | None
    low: float = 0.0


def requirements_of(
    vehicle: RemoteVehicle, place: int, count: int, origin: Origin, scenario: Scenario
) -> FlightRequirements:
    """Requirements of the flight on vehicle `place`, from 0, of `count`."""
    home, edges = vehicle.home(), scenario.arena.inset(-FENCE_MARGIN).extent()
    x, y = origin.world(*home[:2]) if home else (0.0, 0.0)
    layer = scenario.altitude + 2 * _LAYER + place * layer_height(count)
    return FlightRequirements(
        speed=scenario.v_max,
        acceleration=scenario.a_max,
        radius=math.ceil(math.hypot(abs(x) + edges[0], abs(y) + edges[1])),
        top=math.ceil(scenario.altitude + 2 * _LAYER + count * layer_height(count) + _ROOF),
        return_altitude=round(layer, 1),
    )


def layer_height(count: int) -> float:
    """Difference between neighbouring return altitudes of `count` vehicles, m."""
    return min(_LAYER, _LAYERS / count)


async def read_settings(
    vehicle: RemoteVehicle, autopilot: str, requirements: FlightRequirements, origin: Origin
) -> VehicleSettings:
    """Read the parameters and the fence of a vehicle.

    Raises:
        CommandError: the vehicle does not answer.
    """
    values: dict[str, float] = {}
    for spellings in required_parameters(autopilot, requirements):
        # In parallel, since a vehicle does not answer for a parameter that it does not have.
        names = [want.name for want in spellings]
        found = await asyncio.gather(*(read_parameter(vehicle, name, tries=_TRIES) for name in names))
        values |= {name: parameter.value for name, parameter in zip(names, found, strict=True) if parameter is not None}
    capacity = await read_parameter(vehicle, _CAPACITY[autopilot], tries=_TRIES)
    low = await read_parameter(vehicle, _LOW[autopilot], tries=_TRIES)
    shapes = await _read_shapes(vehicle, origin)
    # PX4's -1 and ArduPilot's 0 mean that the capacity is not configured.
    full = capacity.value if capacity and capacity.value > 0 else None
    return VehicleSettings(values=values, shapes=shapes, capacity=full, low=_low_share(autopilot, low, full))


async def _read_shapes(vehicle: RemoteVehicle, origin: Origin) -> tuple[Polygon | Circle, ...] | None:
    """The vehicle's fence, world; None if it is invalid or cannot be read."""
    try:
        items = [
            types.SimpleNamespace(
                command=item.command, param1=item.param1, x=round(item.latitude * 1e7), y=round(item.longitude * 1e7)
            )
            for item in await download_fence(vehicle)
        ]
        return read_fence(items, origin)
    except (FenceError, CommandError):
        return None


def _low_share(autopilot: str, low: Parameter | None, capacity: float | None) -> float:
    """Share of charge at which the failsafe acts; ArduPilot's parameter is in mAh, PX4's is a share."""
    if low is None or (autopilot == "ardupilot" and not capacity):
        return 0.0
    share = low.value / capacity if autopilot == "ardupilot" and capacity else low.value
    return share if 0 <= share <= 1 else 0.0


def settings_items(
    vehicle: RemoteVehicle, autopilot: str, requirements: FlightRequirements, found: VehicleSettings, scenario: Scenario
) -> list[CheckItem]:
    """Check a vehicle's parameters and fence."""
    required = required_parameters(autopilot, requirements)
    items = [item for want in required if (item := _parameter_item(vehicle, want, found.values)) is not None]
    return [*items, _fence_item(vehicle, found.shapes, scenario)]


async def correct_settings(
    vehicle: RemoteVehicle,
    autopilot: str,
    requirements: FlightRequirements,
    found: VehicleSettings,
    origin: Origin,
    scenario: Scenario,
) -> list[str]:
    """Set wrong parameters and upload a fence of the arena; returns the changes as read back, one line each.

    Raises:
        CommandError: the vehicle rejects a change.
    """
    changes = []
    if found.shapes is None or not _fits(found.shapes, scenario):
        await upload_fence(vehicle, _arena_fence(origin, scenario))
        kept_shapes = await _read_shapes(vehicle, origin)
        if kept_shapes is None or not _fits(kept_shapes, scenario):
            raise CommandError(f"{vehicle}: fence: the fence that was read back differs from the upload")
        changes.append(f"{about(vehicle)}: fence: {FENCE_MARGIN:g} m around the {scenario.arena.title}")
    for spellings in required_parameters(autopilot, requirements):
        want = _known(spellings, found.values)
        if want is None:
            continue
        before = found.values[want.name]
        if want.holds(before) and (want.name not in RETURN_ALTITUDE or math.isclose(before, want.value, abs_tol=1e-3)):
            continue
        kept = await set_parameter(vehicle, want.name, want.value)
        changes.append(f"{about(vehicle)}: {want.name}: {before:g} -> {kept.value:g}")
    return changes


def return_altitude(found: VehicleSettings) -> float | None:
    """Return altitude of a vehicle above home, m; None if unknown."""
    altitudes = (found.values[name] * unit for name, unit in RETURN_ALTITUDE.items() if name in found.values)
    return next(altitudes, None)


def _known(spellings: Spellings, values: dict[str, float]) -> RequiredParameter | None:
    return next((want for want in spellings if want.name in values), None)


def _parameter_item(vehicle: RemoteVehicle, spellings: Spellings, values: dict[str, float]) -> CheckItem | None:
    want = _known(spellings, values)
    if not spellings[0].why:
        return None  # checked over the whole flock
    if want is None:
        names, first = " or ".join(want.name for want in spellings), spellings[0]
        advice = f"it does not have {names}: check its firmware version"
        return CheckItem(name=first.name, about=about(vehicle), result=first.missing, limit=first.limit, advice=advice)
    return check(
        want.name, about(vehicle), good=want.holds(values[want.name]), value=values[want.name], limit=want.limit,
        advice=f"{want.why}: {_FIX}", otherwise=want.otherwise,
    )  # fmt: skip


def _fence_item(vehicle: RemoteVehicle, shapes: tuple[Polygon | Circle, ...] | None, scenario: Scenario) -> CheckItem:
    limit = "a polygon that allows the whole arena"
    if shapes is None:
        return CheckItem(
            name="fence", about=about(vehicle), result=CheckResult.FAILURE, value="unreadable", limit=limit, advice=_FIX
        )  # fmt: skip
    if not shapes:
        return CheckItem(
            name="fence", about=about(vehicle), result=CheckResult.WARNING, value="only a circle around its home",
            limit=limit,
            advice=f"the circle reaches far outside the arena: {_FIX}",
        )  # fmt: skip
    return check(
        "fence", about(vehicle), good=_fits(shapes, scenario), value=f"{len(shapes)} shapes", limit=limit,
        advice=f"it forbids parts of the arena, or nothing at all: {_FIX}",
    )  # fmt: skip


def _fits(shapes: tuple[Polygon | Circle, ...], scenario: Scenario) -> bool:
    """Whether there is a fence and it contains the whole arena."""
    if not any(shape.allowed for shape in shapes):
        return False
    rows, columns = (np.linspace(-half, half, _GRID) for half in scenario.arena.extent())
    places = [(float(x), float(y)) for x in rows for y in columns]
    return not any(breaches(shapes, *place) for place in places if scenario.arena.distance_outside(place) <= 0)


def _arena_fence(origin: Origin, scenario: Scenario) -> list[FenceItem]:
    fence = scenario.arena.inset(-FENCE_MARGIN)
    if (round_fence := fence.circle()) is not None:
        x, y, radius = round_fence
        return [FenceItem(mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, radius, *origin.globe(x, y))]
    corners = fence.outline().tolist()
    command = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
    return [FenceItem(command, len(corners), *origin.globe(east, north)) for east, north in corners]
