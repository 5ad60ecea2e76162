"""Exchanges of a ground station with a vehicle: commands, messages and their rates, parameters, fences.

Each exchange is repeated when no answer arrives, since packets get lost.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

from moflock_mj.errors import CommandError
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle
from moflock_mj.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mavlink
from moflock_mj.mavlink.parameters import REAL32, Parameter, carried_value, value_carried

TIMEOUT = 0.7
"""Time to wait for one answer, s."""
TRIES = 5

_FENCE = mavlink.MAV_MISSION_TYPE_FENCE
_FENCE_ITEMS_MAX = 200
_TOLERANCE = 1e-6
"""Relative and absolute tolerance of a parameter that is read back, since it is sent as a 32-bit float."""


class FenceItem(NamedTuple):
    """A corner of a polygon, or the centre of a circle.

    Attributes:
        command: MAV_CMD_NAV_FENCE_...
        param1: number of corners of the polygon, or radius of the circle, m.
        latitude: latitude, degrees.
        longitude: longitude, degrees.
    """

    command: int
    param1: float
    latitude: float
    longitude: float


async def exchange(
    vehicle: RemoteVehicle,
    message: Message,
    names: Collection[str],
    fits: Callable[[Message], bool] = lambda _: True,
    *,
    timeout: float = TIMEOUT,
    tries: int = TRIES,
) -> Message | None:
    """Send a message until an answer with one of these names arrives that fits; None if none arrives."""
    for _ in range(tries):
        with vehicle.expecting(names, fits) as answer:
            vehicle.send(message)
            done, _ = await asyncio.wait([answer], timeout=timeout)
            if done:
                return answer.result()
    return None


async def command(
    vehicle: RemoteVehicle, number: int, *params: float, timeout: float = TIMEOUT, tries: int = TRIES
) -> int | None:
    """Send a COMMAND_LONG; returns the acknowledged MAV_RESULT, or None without an acknowledgement.

    An acknowledgement only proves that the command was understood; the effect must be checked by telemetry.

    Args:
        vehicle: receiver of the command.
        number: MAV_CMD.
        params: up to seven parameters; the others are 0.
        timeout: time to wait for one answer, s.
        tries: maximum number of transmissions.
    """
    for attempt in range(tries):
        with vehicle.expecting(["COMMAND_ACK"], lambda ack: ack.command == number) as answer:
            vehicle.send(command_long(vehicle.system, number, *params, confirmation=attempt))
            done, _ = await asyncio.wait([answer], timeout=timeout)
            if done and answer.result().result != mavlink.MAV_RESULT_IN_PROGRESS:
                return int(answer.result().result)
    return None


def command_long(system: int, number: int, *params: float, confirmation: int = 0) -> Message:
    """A COMMAND_LONG for the autopilot of a system."""
    values = [*params, *[0.0] * (7 - len(params))]
    return mavlink.MAVLink_command_long_message(system, AUTOPILOT_COMPONENT, number, confirmation, *values)


async def request_message(vehicle: RemoteVehicle, number: int, *, tries: int = TRIES) -> Message | None:
    """Request one message by its id; None if it does not arrive."""
    name = mavlink.mavlink_map[number].msgname
    request = command_long(vehicle.system, mavlink.MAV_CMD_REQUEST_MESSAGE, number)
    message = await exchange(vehicle, request, [name], tries=tries)
    if message is None and number == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
        old = command_long(vehicle.system, mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1)
        message = await exchange(vehicle, old, [name], tries=1)
    return message


async def set_rates(vehicle: RemoteVehicle, rates: dict[int, float]) -> list[int]:
    """Request messages at rates in Hz, by message id; returns the ids that were refused or not acknowledged."""
    refused = []
    for number, rate in rates.items():
        result = await command(vehicle, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate if rate > 0 else -1)
        if result != mavlink.MAV_RESULT_ACCEPTED:
            refused.append(number)
    return refused


async def read_parameter(vehicle: RemoteVehicle, name: str, *, tries: int = TRIES) -> Parameter | None:
    """Read a parameter by its name; None without an answer, which is also the case for a name that does not exist."""
    request = mavlink.MAVLink_param_request_read_message(vehicle.system, AUTOPILOT_COMPONENT, name.encode(), -1)
    answer = await exchange(vehicle, request, ["PARAM_VALUE"], lambda message: message.param_id == name, tries=tries)
    return None if answer is None else _parameter_of(vehicle, answer)


async def set_parameter(vehicle: RemoteVehicle, name: str, value: float) -> Parameter:
    """Set a parameter and read it back; returns the parameter that was read back.

    Raises:
        CommandError: the vehicle does not have the parameter, does not answer, or keeps another value.
    """
    known = await read_parameter(vehicle, name)
    if known is None:
        raise CommandError(f"{vehicle}: parameter {name}: no answer")
    carried = value_carried(value, known.kind, bytewise=_bytewise(vehicle))
    request = mavlink.MAVLink_param_set_message(vehicle.system, AUTOPILOT_COMPONENT, name.encode(), carried, known.kind)
    # The answer should already be the stored value; it is read again to be certain.
    await exchange(vehicle, request, ["PARAM_VALUE"], lambda message: message.param_id == name)
    kept = await read_parameter(vehicle, name)
    if kept is None or not math.isclose(kept.value, value, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE):
        has = "no answer" if kept is None else f"it keeps {kept.value:g}"
        raise CommandError(f"{vehicle}: parameter {name}: {value:g} was set, but {has}")
    return kept


async def upload_fence(vehicle: RemoteVehicle, items: Sequence[FenceItem]) -> None:
    """Replace the vehicle's fence.

    Raises:
        CommandError: the vehicle does not answer, or refuses the fence.
    """
    target = (vehicle.system, AUTOPILOT_COMPONENT)
    names = ["MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK"]

    def of_fence(answer: Message) -> bool:
        return bool(answer.mission_type == _FENCE)

    answer = await exchange(
        vehicle, mavlink.MAVLink_mission_count_message(*target, len(items), _FENCE), names, of_fence
    )
    for _ in range(4 * len(items) + TRIES):
        if answer is None:
            raise CommandError(f"{vehicle}: fence: no answer")
        if answer.get_type() == "MISSION_ACK":
            if answer.type != mavlink.MAV_MISSION_ACCEPTED:
                raise CommandError(f"{vehicle}: fence: refused, MAV_MISSION_RESULT {answer.type}")
            return
        if not 0 <= answer.seq < len(items):
            raise CommandError(
                f"{vehicle}: fence upload: item {answer.seq} was requested; it must be below {len(items)}"
            )
        item = _item_message(vehicle.system, answer.seq, items[answer.seq])
        requested = answer.seq

        # A repeated request that crossed the item in transit is not the next one.
        def is_next(answer: Message, requested: int = requested) -> bool:
            return of_fence(answer) and (answer.get_type() == "MISSION_ACK" or answer.seq != requested)

        answer = await exchange(vehicle, item, names, is_next)
    requests = 4 * len(items) + TRIES
    raise CommandError(f"{vehicle}: fence upload: the vehicle keeps requesting items; gave up after {requests}")


async def download_fence(vehicle: RemoteVehicle) -> list[FenceItem]:
    """Download the vehicle's fence.

    Raises:
        CommandError: the vehicle does not answer.
    """
    target = (vehicle.system, AUTOPILOT_COMPONENT)
    request = mavlink.MAVLink_mission_request_list_message(*target, _FENCE)
    count = await exchange(vehicle, request, ["MISSION_COUNT"], lambda message: message.mission_type == _FENCE)
    if count is None:
        raise CommandError(f"{vehicle}: fence: no answer")
    items = []
    for number in range(min(count.count, _FENCE_ITEMS_MAX)):
        request = mavlink.MAVLink_mission_request_int_message(*target, number, _FENCE)
        item = await exchange(
            vehicle,
            request,
            ["MISSION_ITEM_INT"],
            lambda message, number=number: message.mission_type == _FENCE and message.seq == number,  # type: ignore[misc]
        )
        if item is None:
            raise CommandError(f"{vehicle}: fence: item {number} of {count.count} does not arrive")
        items.append(FenceItem(item.command, item.param1, item.x / 1e7, item.y / 1e7))
    vehicle.send(mavlink.MAVLink_mission_ack_message(*target, mavlink.MAV_MISSION_ACCEPTED, _FENCE))
    return items


def _item_message(system: int, number: int, item: FenceItem) -> Message:
    return mavlink.MAVLink_mission_item_int_message(
        system, AUTOPILOT_COMPONENT, number, mavlink.MAV_FRAME_GLOBAL, item.command, 0, 1, item.param1, 0, 0, 0,
        round(item.latitude * 1e7), round(item.longitude * 1e7), 0, _FENCE,
    )  # fmt: skip


def _bytewise(vehicle: RemoteVehicle) -> bool:
    """Whether integers are encoded as the bytes of the float: by AUTOPILOT_VERSION, else by the autopilot."""
    version = vehicle.message("AUTOPILOT_VERSION")
    if version is not None:
        bytewise = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        cast = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
        if version.capabilities & (bytewise | cast):
            return bool(version.capabilities & bytewise)
    return bool(vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4)


def _parameter_of(vehicle: RemoteVehicle, message: Message) -> Parameter:
    value = carried_value(message.param_value, message.param_type, bytewise=_bytewise(vehicle))
    # Round to the precision of a 32-bit float: 0.8 instead of 0.800000011920929.
    return Parameter(message.param_type, float(f"{value:.7g}") if message.param_type == REAL32 else value)
