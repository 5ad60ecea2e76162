"""Flight commands for ArduCopter and PX4: take off, follow velocity setpoints, hold, return, land.

The effect of a command is confirmed by HEARTBEAT and position, never by its acknowledgement: PX4 accepts OFFBOARD
without a stream of setpoints, and ArduCopter accepts a take-off that a setpoint then cancels.
"""

from __future__ import annotations

import asyncio
import enum
import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from moflock_mj.errors import CommandError
from moflock_mj.ground_station.commands import command, command_long
from moflock_mj.ground_station.flight_modes import ArduCopterMode, Px4Mode, mode_name
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mavlink
from moflock_mj.mavlink.frames import Triple, ned_of_world

REPEAT_INTERVAL = 1.0
"""Interval at which a command is repeated until HEARTBEAT confirms it, s."""
STREAM_FIRST = 1.0
"""Time for which PX4 must receive setpoints before OFFBOARD, s."""
_OFF_THE_GROUND = 30.0
"""Time to leave the ground, s: rotors spool up for seconds of the vehicle's clock, which a busy simulator slows."""
_POLL = 0.05
_VELOCITY_ONLY = 0xDC7
"""Type mask of SET_POSITION_TARGET_LOCAL_NED that selects the velocity only."""
_NAN = math.nan


class FlightTask(enum.StrEnum):
    """Task of a vehicle in the air."""

    OFFBOARD = "obey"
    HOLD = "hold"
    RETURN = "return"
    LAND = "land"


class AutopilotProfile(NamedTuple):
    """Properties of an autopilot.

    Attributes:
        name: name on the command line.
        modes: custom_mode of each task. ArduCopter holds in BRAKE, since LOITER descends without a remote control.
        taking_off: custom_modes that HEARTBEAT can show between arming and the end of a take-off.
        streams_first: whether setpoints must be sent before OFFBOARD is requested, and not during the take-off.
    """

    name: str
    modes: Mapping[FlightTask, int]
    taking_off: tuple[int, ...]
    streams_first: bool


PROFILES: Mapping[int, AutopilotProfile] = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: AutopilotProfile(
        "ardupilot",
        {
            FlightTask.OFFBOARD: ArduCopterMode.GUIDED,
            FlightTask.HOLD: ArduCopterMode.BRAKE,
            FlightTask.RETURN: ArduCopterMode.RTL,
            FlightTask.LAND: ArduCopterMode.LAND,
        },
        (ArduCopterMode.GUIDED,),
        False,
    ),
    mavlink.MAV_AUTOPILOT_PX4: AutopilotProfile(
        "px4",
        {
            FlightTask.OFFBOARD: Px4Mode.OFFBOARD,
            FlightTask.HOLD: Px4Mode.HOLD,
            FlightTask.RETURN: Px4Mode.RETURN,
            FlightTask.LAND: Px4Mode.LAND,
        },
        (Px4Mode.TAKEOFF, Px4Mode.HOLD),
        True,
    ),
}
"""Profiles by MAV_AUTOPILOT."""


def profile_of(vehicle: RemoteVehicle) -> AutopilotProfile:
    """Profile of a vehicle's autopilot.

    Raises:
        CommandError: the autopilot is not supported, or the vehicle is a fixed wing.
    """
    profile = PROFILES.get(vehicle.autopilot)
    if profile is None:
        raise CommandError(f"{vehicle}: autopilot {vehicle.autopilot} is unknown: it must be ArduPilot (3) or PX4 (12)")
    kind = vehicle.latest["HEARTBEAT"].message.type
    if kind == mavlink.MAV_TYPE_FIXED_WING:
        raise CommandError(f"{vehicle}: is a fixed wing: it must be a multicopter")
    return profile


def mode_command(vehicle: RemoteVehicle, mode: int) -> Message:
    """Command that sets a custom_mode."""
    custom = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    if vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4:
        # PX4 expects main mode and sub-mode as separate parameters.
        return command_long(vehicle.system, mavlink.MAV_CMD_DO_SET_MODE, custom, mode >> 16 & 255, mode >> 24 & 255)
    return command_long(vehicle.system, mavlink.MAV_CMD_DO_SET_MODE, custom, mode)


def velocity_setpoint(system: int, velocity: Triple, milliseconds: int = 0) -> Message:
    """Velocity setpoint that keeps the heading.

    Args:
        system: system id of the receiver.
        velocity: east, north, up, m/s, world.
        milliseconds: time since the sender's start, ms.
    """
    return mavlink.MAVLink_set_position_target_local_ned_message(
        milliseconds % 2**32, system, AUTOPILOT_COMPONENT, mavlink.MAV_FRAME_LOCAL_NED, _VELOCITY_ONLY,
        0, 0, 0, *ned_of_world(velocity), 0, 0, 0, 0, 0,
    )  # fmt: skip


async def set_mode(vehicle: RemoteVehicle, mode: int, *, timeout: float = 5.0) -> None:
    """Set a custom_mode and wait until HEARTBEAT confirms it.

    Raises:
        CommandError: HEARTBEAT does not confirm it in time.
    """
    if (said := await _until(vehicle, mode_command(vehicle, mode), lambda: vehicle.mode == mode, timeout)) is not None:
        wanted = mode_name(vehicle.autopilot, mode)
        raise CommandError(f"{vehicle}: stays in {vehicle.mode_name}, although {wanted} was requested{said}")


async def arm(vehicle: RemoteVehicle, *, timeout: float = 5.0) -> None:
    """Arm without force.

    Raises:
        CommandError: the vehicle does not arm; the message includes its status texts.
    """
    request = command_long(vehicle.system, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    if (said := await _until(vehicle, request, lambda: vehicle.armed, timeout)) is not None:
        raise CommandError(f"{vehicle}: does not arm{said}")


async def disarm(vehicle: RemoteVehicle, *, timeout: float = 5.0) -> None:
    """Disarm on the ground; in the air an autopilot refuses.

    Raises:
        CommandError: the vehicle does not disarm.
    """
    request = command_long(vehicle.system, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    if (said := await _until(vehicle, request, lambda: not vehicle.armed, timeout)) is not None:
        raise CommandError(f"{vehicle}: does not disarm{said}")


async def take_off(vehicle: RemoteVehicle, height: float, *, timeout: float = 10.0) -> None:
    """Arm and take off; returns as soon as the vehicle climbs, before it is at its height.

    ArduCopter must not receive a velocity setpoint before it is at its height, since it would stop climbing.

    Args:
        vehicle: vehicle on the ground.
        height: height above its home, m.
        timeout: time for the mode change and for arming, s.

    Raises:
        CommandError: the vehicle does not take off.
    """
    if profile_of(vehicle).name == "ardupilot":
        await set_mode(vehicle, PROFILES[vehicle.autopilot].modes[FlightTask.OFFBOARD], timeout=timeout)
        await arm(vehicle, timeout=timeout)
        params: tuple[float, ...] = (0, 0, 0, 0, 0, 0, height)
    else:
        # PX4 does not arm in LAND, nor in OFFBOARD without a stream, its modes after a flight.
        await set_mode(vehicle, PROFILES[vehicle.autopilot].modes[FlightTask.HOLD], timeout=timeout)
        await arm(vehicle, timeout=timeout)
        # PX4 expects the altitude above mean sea level; NaN keeps place and heading.
        place = vehicle.fix
        if place is None:
            raise CommandError(f"{vehicle}: does not report its position")
        params = (_NAN, 0, 0, _NAN, _NAN, _NAN, place.altitude - place.height + height)
    request = command_long(vehicle.system, mavlink.MAV_CMD_NAV_TAKEOFF, *params)

    def climbs() -> bool:
        return vehicle.landed is False or (vehicle.fix is not None and vehicle.fix.height > 0.5)

    if (said := await _until(vehicle, request, climbs, _OFF_THE_GROUND)) is not None:
        raise CommandError(f"{vehicle}: does not take off{said}")


async def begin(vehicle: RemoteVehicle, task: FlightTask, *, timeout: float = 5.0) -> None:
    """Let a vehicle in the air hold, return, land, or follow setpoints.

    Before `FlightTask.OFFBOARD`, setpoints must have been sent for STREAM_FIRST, and must continue.

    Raises:
        CommandError: HEARTBEAT does not confirm it.
    """
    await set_mode(vehicle, profile_of(vehicle).modes[task], timeout=timeout)


async def run_prearm_checks(vehicle: RemoteVehicle) -> int | None:
    """Request the pre-arm checks, whose failures arrive as status texts; returns the MAV_RESULT."""
    return await command(vehicle, mavlink.MAV_CMD_RUN_PREARM_CHECKS)


async def _until(vehicle: RemoteVehicle, request: Message, done: Callable[[], bool], timeout: float) -> str | None:
    """Repeat a command until it takes effect; returns None, or the vehicle's status texts after a timeout."""
    loop = asyncio.get_running_loop()
    began = repeat_at = loop.time()
    while not done():
        now = loop.time()
        if now >= began + timeout:
            return _texts_since(vehicle, began)
        if now >= repeat_at:
            vehicle.send(request)
            repeat_at = now + REPEAT_INTERVAL
        await asyncio.sleep(_POLL)
    return None


def _texts_since(vehicle: RemoteVehicle, time: float) -> str:
    """The last warnings of a vehicle since a time, which can state a reason; empty if there are none."""
    warnings = [
        status_text.text
        for status_text in vehicle.texts
        if status_text.severity <= mavlink.MAV_SEVERITY_WARNING and status_text.time >= time
    ]
    texts = list(dict.fromkeys(warnings))
    return f": it reports {'; '.join(texts[-2:])}" if texts else ""
