"""CPU time of a fleet of 30 and its ground station in real time: `python -m tests.benchmarks.fleet`."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import sys
import time

from moflock_mj.mavlink.dialect import GROUND_COMPONENT, GROUND_SYSTEM, mavlink
from moflock_mj.mavlink.endpoint import Endpoint
from moflock_mj.mavlink.signing import SigningKey
from moflock_mj.simulated_vehicles.fleet import Fleet, FleetPlan

VEHICLES = 30
BASE_PORT = 15600
SECONDS = 30.0
OFFBOARD = 6 << 16
CLIMB = 4.0
"""Duration of upward setpoints before those to the north, s."""


async def command(key: SigningKey | None, counted: dict[str, int]) -> None:
    """Switch all vehicles to OFFBOARD, arm them, and send setpoints at 20 Hz and heartbeats at 1 Hz."""

    def note(message: object, _: object) -> None:
        kind = message.get_type()  # type: ignore[attr-defined]
        counted[kind] = counted.get(kind, 0) + 1

    endpoint = Endpoint(GROUND_SYSTEM, note, component=GROUND_COMPONENT, key=key)
    await endpoint.open()
    peers = [endpoint.peer(("127.0.0.1", BASE_PORT + number)) for number in range(VEHICLES)]
    loop = asyncio.get_running_loop()
    began, step = loop.time(), 0
    while True:
        for system, peer in enumerate(peers, 1):
            if step % 20 == 0:
                endpoint.send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3), peer)
            down, north = (-1.0, 0.0) if step < 20 * CLIMB else (0.0, 2.0)
            endpoint.send(
                mavlink.MAVLink_set_position_target_local_ned_message(
                    0, system, 1, 1, 0xDC7, 0, 0, 0, north, 0, down, 0, 0, 0, 0, 0
                ),
                peer,
            )
            if step in (10, 20):
                endpoint.send(mavlink.MAVLink_command_long_message(system, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0), peer)
                endpoint.send(mavlink.MAVLink_command_long_message(system, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0), peer)
        step += 1
        await asyncio.sleep(max(began + step * 0.05 - loop.time(), 0))


def ground_station(signed: bool) -> None:
    key = SigningKey(bytes(range(32))) if signed else None
    counted: dict[str, int] = {}

    async def stream() -> None:
        await asyncio.wait_for(command(key, counted), SECONDS - 1)

    try:
        asyncio.run(stream())
    except TimeoutError:
        received = sum(counted.values()) / (SECONDS - 1)
        share = time.process_time() / SECONDS
        print(f"  ground station: {share:.0%} of a core, {received:.0f} packets/s received", flush=True)


async def rehearse(fleet: Fleet) -> tuple[float, float]:
    """CPU time and wall time of a flight, s."""
    await fleet.open()
    cpu, wall = time.process_time(), time.perf_counter()
    try:
        await fleet.run(SECONDS)
    finally:
        fleet.close()
    return time.process_time() - cpu, time.perf_counter() - wall


def main() -> None:
    for signed in (False, True):
        key = SigningKey(bytes(range(32))) if signed else None
        plan = FleetPlan(vehicles=VEHICLES, autopilot="px4", base_port=BASE_PORT, boot=0.0)
        fleet = Fleet(plan, key)
        other = multiprocessing.get_context("spawn").Process(target=ground_station, args=(signed,))
        other.start()
        cpu, wall = asyncio.run(rehearse(fleet))
        state = fleet.state()
        other.join()
        print(
            f"{VEHICLES} vehicles, {'signed' if signed else 'unsigned'}: {SECONDS / wall:.3f} of real time, "
            f"{cpu / SECONDS:.0%} of a core; {state.flying} flying, {state.sent / SECONDS:.0f} packets/s sent, "
            f"{state.received / SECONDS:.0f} received, {state.dropped} dropped, {state.lost} lost; "
            f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}",
            flush=True,
        )


if __name__ == "__main__":
    sys.exit(main())
