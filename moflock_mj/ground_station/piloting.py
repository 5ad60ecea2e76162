"""Flying a vehicle from the ground, the same for ArduCopter and PX4: take off, obey velocities, hold, return, land.

What a vehicle does is believed by its HEARTBEAT and its position, never by its acknowledgements: PX4 accepts OFFBOARD
without a stream, and ArduCopter a take-off that a setpoint then cancels.
"""

from __future__ import annotations

import asyncio
import enum
import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from moflock_mj.errors import CommandError
from moflock_mj.ground_station.commands import command, command_long
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle, mode_name
from moflock_mj.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mavlink
from moflock_mj.mavlink.frames import Triple, ned_of_world

ASK_AGAIN = 1.0
"""s, after which an order that has not shown in HEARTBEAT is given again."""
STREAM_FIRST = 1.0
"""s of setpoints that PX4 wants to have seen before OFFBOARD."""
_OFF_THE_GROUND = 30.0
"""s, for leaving the ground: rotors spool up for some seconds, on the vehicle's clock, which a busy simulator slows."""
_POLL = 0.05
_VELOCITY_ONLY = 0xDC7
"""Type mask of SET_POSITION_TARGET_LOCAL_NED: everything but the velocity is ignored."""
_NAN = math.nan


class FlightTask(enum.StrEnum):
    """What a vehicle in the air can be told to do."""

    OFFBOARD = "obey"
    HOLD = "hold"
    RETURN = "return"
    LAND = "land"


class AutopilotProfile(NamedTuple):
    """What is particular to an autopilot.

    Attributes:
        name: as our command line has it.
        modes: custom_mode of each task. ArduCopter holds in BRAKE: LOITER without a remote control descends.
        taking_off: custom_modes that HEARTBEAT may show between arming and the end of a take-off.
        streams_first: whether setpoints must come before the mode that obeys them, and not during the take-off.
    """

    name: str
    modes: Mapping[FlightTask, int]
    taking_off: tuple[int, ...]
    streams_first: bool


def _px4(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


PROFILES: Mapping[int, AutopilotProfile] = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: AutopilotProfile(
        "ardupilot",
        {FlightTask.OFFBOARD: 4, FlightTask.HOLD: 17, FlightTask.RETURN: 6, FlightTask.LAND: 9},
        (4,),
        False,
    ),
    mavlink.MAV_AUTOPILOT_PX4: AutopilotProfile(
        "px4",
        {
            FlightTask.OFFBOARD: _px4(6),
            FlightTask.HOLD: _px4(4, 3),
            FlightTask.RETURN: _px4(4, 5),
            FlightTask.LAND: _px4(4, 6),
        },
        (_px4(4, 2), _px4(4, 3)),
        True,
    ),
}
"""By MAV_AUTOPILOT."""


def profile_of(vehicle: RemoteVehicle) -> AutopilotProfile:
    """The style of a vehicle's autopilot.

    Raises:
        CommandError: it is one that we cannot fly.
    """
    profile = PROFILES.get(vehicle.autopilot)
    if profile is None:
        raise CommandError(f"{vehicle}: autopilot {vehicle.autopilot} is unknown: it must be ArduPilot (3) or PX4 (12)")
    kind = vehicle.latest["HEARTBEAT"].message.type
    if kind == mavlink.MAV_TYPE_FIXED_WING:
        raise CommandError(f"{vehicle}: is a fixed wing: it must be a multicopter")
    return profile


def mode_order(vehicle: RemoteVehicle, mode: int) -> Message:
    """The command that asks for a custom_mode."""
    custom = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    if vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4:
        # PX4 takes main and sub mode apart.
        return command_long(vehicle.system, mavlink.MAV_CMD_DO_SET_MODE, custom, mode >> 16 & 255, mode >> 24 & 255)
    return command_long(vehicle.system, mavlink.MAV_CMD_DO_SET_MODE, custom, mode)


def velocity_setpoint(system: int, velocity: Triple, milliseconds: int = 0) -> Message:
    """A setpoint of a velocity, m/s, world; the heading stays.

    Args:
        system: whom it is for.
        velocity: east, north, up.
        milliseconds: time stamp, since the sender's start.
    """
    return mavlink.MAVLink_set_position_target_local_ned_message(
        milliseconds % 2**32, system, AUTOPILOT_COMPONENT, mavlink.MAV_FRAME_LOCAL_NED, _VELOCITY_ONLY,
        0, 0, 0, *ned_of_world(velocity), 0, 0, 0, 0, 0,
    )  # fmt: skip


async def set_mode(vehicle: RemoteVehicle, mode: int, *, timeout: float = 5.0) -> None:
    """Ask for a custom_mode until HEARTBEAT shows it.

    Raises:
        CommandError: it does not, in time.
    """
    if (said := await _until(vehicle, mode_order(vehicle, mode), lambda: vehicle.mode == mode, timeout)) is not None:
        wanted = mode_name(vehicle.autopilot, mode)
        raise CommandError(f"{vehicle}: stays in {vehicle.mode_name}, asked for {wanted}{said}")


async def arm(vehicle: RemoteVehicle, *, timeout: float = 5.0) -> None:
    """Arm, never by force.

    Raises:
        CommandError: it does not arm; with what it says.
    """
    order = command_long(vehicle.system, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    if (said := await _until(vehicle, order, lambda: vehicle.armed, timeout)) is not None:
        raise CommandError(f"{vehicle}: does not arm{said}")


async def disarm(vehicle: RemoteVehicle, *, timeout: float = 5.0) -> None:
    """Disarm on the ground; in the air an autopilot refuses.

    Raises:
        CommandError: it does not disarm.
    """
    order = command_long(vehicle.system, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    if (said := await _until(vehicle, order, lambda: not vehicle.armed, timeout)) is not None:
        raise CommandError(f"{vehicle}: does not disarm{said}")


async def take_off(vehicle: RemoteVehicle, height: float, *, timeout: float = 10.0) -> None:
    """Arm and leave the ground; returns as soon as it climbs, long before it is at its height.

    ArduCopter must not get a velocity setpoint before it is there: it would stop.

    Args:
        vehicle: stands on the ground.
        height: m, above its home.
        timeout: s, for the mode and for arming.

    Raises:
        CommandError: it does not.
    """
    if profile_of(vehicle).name == "ardupilot":
        await set_mode(vehicle, PROFILES[vehicle.autopilot].modes[FlightTask.OFFBOARD], timeout=timeout)
        await arm(vehicle, timeout=timeout)
        params: tuple[float, ...] = (0, 0, 0, 0, 0, 0, height)
    else:
        # PX4 does not arm in LAND, nor in OFFBOARD without a stream, where it is again after a flight.
        await set_mode(vehicle, PROFILES[vehicle.autopilot].modes[FlightTask.HOLD], timeout=timeout)
        await arm(vehicle, timeout=timeout)
        # PX4 counts above mean sea level; NaN: where it is, as it points.
        place = vehicle.fix
        if place is None:
            raise CommandError(f"{vehicle}: does not say where it is")
        params = (_NAN, 0, 0, _NAN, _NAN, _NAN, place.altitude - place.height + height)
    order = command_long(vehicle.system, mavlink.MAV_CMD_NAV_TAKEOFF, *params)

    def climbs() -> bool:
        return vehicle.landed is False or (vehicle.fix is not None and vehicle.fix.height > 0.5)

    if (said := await _until(vehicle, order, climbs, _OFF_THE_GROUND)) is not None:
        raise CommandError(f"{vehicle}: does not take off{said}")


async def begin(vehicle: RemoteVehicle, task: FlightTask, *, timeout: float = 5.0) -> None:
    """Let a vehicle in the air hold, return, land, or obey setpoints.

    Before Task.OBEY somebody must stream setpoints to it already, for STREAM_FIRST, and go on.

    Raises:
        CommandError: HEARTBEAT does not show it.
    """
    await set_mode(vehicle, profile_of(vehicle).modes[task], timeout=timeout)


async def run_prearm_checks(vehicle: RemoteVehicle) -> int | None:
    """Ask a vehicle to tell why it would not arm, in status texts; returns the MAV_RESULT."""
    return await command(vehicle, mavlink.MAV_CMD_RUN_PREARM_CHECKS)


async def _until(vehicle: RemoteVehicle, order: Message, done: Callable[[], bool], timeout: float) -> str | None:
    """Give an order, and give it again, until it shows; None if it does, else what the vehicle said of it, in words."""
    loop = asyncio.get_running_loop()
    began = again = loop.time()
    while not done():
        now = loop.time()
        if now >= began + timeout:
            return _said_since(vehicle, began)
        if now >= again:
            vehicle.send(order)
            again = now + ASK_AGAIN
        await asyncio.sleep(_POLL)
    return None


def _said_since(vehicle: RemoteVehicle, time: float) -> str:
    """The last words of a vehicle since a time, as they may tell why; nothing if it has said nothing."""
    grave = [told for told in vehicle.texts if told.severity <= mavlink.MAV_SEVERITY_WARNING and told.time >= time]
    words = dict.fromkeys(told.text for told in grave)
    return f": it says {'; '.join(list(words)[-2:])}" if words else ""
