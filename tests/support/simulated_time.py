"""Fleet and ground station on an event loop with simulated time and without sockets."""

from __future__ import annotations

import asyncio
import contextlib
import selectors

import pytest

from moflock_mj.ground_station.station import GroundStation
from moflock_mj.mavlink.addresses import Connection
from moflock_mj.mavlink.endpoint import Endpoint
from moflock_mj.simulated_vehicles.fleet import TICK


class _Jump(selectors.SelectSelector):
    """Selector that adds each timeout to its clock instead of waiting."""

    def __init__(self):
        super().__init__()
        self.now = 0.0

    def select(self, timeout=None):
        ready = super().select(0)
        if not ready:
            if timeout is None:
                raise RuntimeError("the event loop has no timer and no ready event: it would wait forever")
            self.now += timeout
        return ready


class SimulatedLoop(asyncio.SelectorEventLoop):
    """Event loop in simulated time."""

    def __init__(self):
        self._jump = _Jump()
        super().__init__(self._jump)
        self._clock_resolution = 1e-9

    def time(self):
        return self._jump.now

    def hold_up(self, seconds):
        """Let time pass in which the loop does nothing, as on a machine that is too busy."""
        self._jump.now += seconds


def run(coroutine):
    """Run a coroutine in simulated time and return its result."""
    with asyncio.Runner(loop_factory=SimulatedLoop) as runner:
        return runner.run(coroutine)


class Wire:
    """Transport that delivers packets to the endpoint bound at their address, in the loop's next iteration."""

    bound: dict

    def __init__(self, bound, own):
        self.bound, self.own = bound, own

    def sendto(self, packet, address):
        other = self.bound.get(address)
        if other is not None:
            asyncio.get_running_loop().call_soon(other.datagram_received, packet, self.own)

    def close(self):
        self.bound.pop(self.own, None)


class Wires:
    """Network in memory for endpoints that are opened inside `used`."""

    def __init__(self):
        self.bound = {}
        self._free = 50_000

    @contextlib.contextmanager
    def used(self):
        wires = self

        async def open_wire(endpoint, host="127.0.0.1", port=0):
            if not port:
                port = wires._free = wires._free + 1
            wires.bound[host, port] = endpoint
            endpoint.connection_made(Wire(wires.bound, (host, port)))
            return host, port

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Endpoint, "open", open_wire)
            yield self


@contextlib.asynccontextmanager
async def flying(fleet, watch=lambda: None):
    """Step a fleet by the loop's clock; `watch` is called after each step."""

    async def fly():
        loop = asyncio.get_running_loop()
        began, done = loop.time(), 0
        while True:
            fleet.tick()
            watch()
            done += 1
            await asyncio.sleep(began + done * TICK - loop.time())

    await fleet.open()
    task = asyncio.create_task(fly())
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
        fleet.close()


def connections_to(fleet):
    return tuple(
        Connection("udpout", "127.0.0.1", fleet.plan.base_port + number) for number in range(fleet.plan.vehicles)
    )


def ground_of(fleet, key=None):
    return GroundStation(connections_to(fleet), key)
