"""A ground station: links to real or simulated vehicles, heartbeats to them, and routes by system id.

All times are those of the event loop, so that a whole exchange can be tested on a loop with a simulated clock.
"""

from __future__ import annotations

import asyncio
import collections
import contextlib
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from typing import NamedTuple

from moflock_mj.errors import LinkError
from moflock_mj.ground_station.remote_vehicle import RemoteVehicle, timesync_stamp
from moflock_mj.mavlink.addresses import CONNECTIONS_MAX, Connection
from moflock_mj.mavlink.dialect import AUTOPILOT_COMPONENT, GROUND_COMPONENT, GROUND_SYSTEM, Message, mavlink
from moflock_mj.mavlink.endpoint import Counts, Endpoint, Peer
from moflock_mj.mavlink.signing import SigningClock, SigningKey
from moflock_mj.mavlink.tcp import open_stream

HEARTBEAT_INTERVAL = 1.0
"""Interval of heartbeats to each vehicle, and of round-trip measurements, s."""
MOVED_AFTER = 5.0
"""Silence after which a vehicle may return from another address, s."""
_POLL = 0.05
"""Interval of the check whether all vehicles are connected, s."""


class Traffic(NamedTuple):
    """A packet from or to a vehicle.

    Attributes:
        time: time, s on the event loop's clock.
        system: system id of the vehicle; 0 for a packet to all vehicles of a link.
        is_sent: whether it was sent by the ground station.
        packet: bytes of the packet.
    """

    time: float
    system: int
    is_sent: bool
    packet: bytes


class GroundLink:
    """One connection, its endpoint, and the system ids received on it.

    Args:
        connection: address of the connection.
        receive: callback that receives each message and its sender.
        key: signing key, or None.
        clock: clock of the signatures.
    """

    def __init__(
        self,
        connection: Connection,
        receive: Callable[[GroundLink, Message, Peer], None],
        key: SigningKey | None,
        clock: SigningClock,
    ) -> None:
        self.connection = connection
        self.systems: set[int] = set()
        self.endpoint = Endpoint(
            GROUND_SYSTEM,
            lambda message, peer: receive(self, message, peer),
            component=GROUND_COMPONENT,
            key=key,
            clock=clock,
            peers_max=CONNECTIONS_MAX,
        )

    async def open(self) -> None:
        """Bind, or connect.

        Raises:
            LinkError: the port is in use, or the connection is refused.
        """
        kind, host, port = self.connection
        if kind == "udpin":
            await self.endpoint.open(host, port)
            return
        if kind == "tcp":
            await open_stream(self.endpoint, (host, port))
        else:
            await self.endpoint.open("127.0.0.1" if self.connection.is_local else "0.0.0.0", 0)
        self.endpoint.peer((host, port))


class GroundStation:
    """Links to vehicles; an asynchronous context manager that opens and closes them.

    Args:
        connections: addresses of the vehicles.
        key: signing key of the links, or None.

    Attributes:
        vehicles: vehicles by system id.
        heartbeats_enabled: whether heartbeats are sent; an unhealthy controller stops them, so that the vehicles' own
            failsafes act.
        observers: callbacks that receive every packet.
    """

    def __init__(self, connections: Sequence[Connection], key: SigningKey | None = None) -> None:
        self.vehicles: dict[int, RemoteVehicle] = {}
        self.heartbeats_enabled = True
        self.observers: list[Callable[[Traffic], None]] = []
        self._routes: dict[int, tuple[GroundLink, tuple[str, int]]] = {}
        self._heartbeat_task: asyncio.Task[None] | None = None
        clock = SigningClock()
        self.links = [GroundLink(connection, self._receive, key, clock) for connection in connections]

    async def __aenter__(self) -> GroundStation:
        try:
            for link in self.links:
                await link.open()
        except BaseException:
            self.close()
            raise
        self._heartbeat_task = asyncio.create_task(self._run_heartbeats())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._heartbeat_task is not None:
            self._heartbeat_task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._heartbeat_task
        self.close()

    def close(self) -> None:
        for link in self.links:
            link.endpoint.close()

    async def connect(self, *, count: int | None = None, timeout: float = 10.0) -> list[RemoteVehicle]:
        """Wait until each link has a vehicle, and `count` vehicles are connected.

        Args:
            count: number of vehicles, several of which may share a link; None for one on each link.
            timeout: time to wait, s.

        Returns:
            The vehicles, ordered by system id.

        Raises:
            LinkError: vehicles are missing, there are more than expected, or two share a system id.
        """
        loop = asyncio.get_running_loop()
        wanted = len(self.links) if count is None else count
        deadline = loop.time() + timeout
        while (self._silent_links() or len(self.vehicles) < wanted) and loop.time() < deadline:
            await asyncio.sleep(_POLL)
        # A second vehicle with the same system id sends within one heartbeat interval of the first.
        await asyncio.sleep(1.2 * HEARTBEAT_INTERVAL)
        self.check_ids()
        silent = self._silent_links()
        if silent:
            names = ", ".join(str(link.connection) for link in silent[:5]) + (", ..." if len(silent) > 5 else "")
            raise LinkError(
                f"vehicles: no heartbeat of an autopilot from {len(silent)} of {len(self.links)} links "
                f"within {timeout:g} s: {names}{self._hint()}"
            )
        found = len(self.vehicles)
        if found != wanted:
            ids = ", ".join(map(str, sorted(self.vehicles)))
            # An unexpected vehicle would fly uncontrolled among the others.
            share = ", one on each link: several on one link need --count" if count is None else ""
            raise LinkError(f"vehicles: {found} connected (system ids {ids}); it must be {wanted}{share}")
        return [self.vehicles[system] for system in sorted(self.vehicles)]

    @contextlib.contextmanager
    def observed_by(self, observer: Callable[[Traffic], None]) -> Iterator[None]:
        """Pass every packet to an observer within this context."""
        self.observers.append(observer)
        try:
            yield
        finally:
            self.observers.remove(observer)

    def check_ids(self) -> None:
        """Refuse two vehicles with one system id.

        Raises:
            LinkError: two vehicles share a system id.
        """
        for vehicle in self.vehicles.values():
            if vehicle.rivals:
                others = ", ".join(sorted(vehicle.rivals))
                raise LinkError(f"vehicles: system id {vehicle.system} is used by {vehicle.where} and {others}")

    def counts(self) -> Counts:
        """Packet counts summed over all links."""
        total = Counts()
        for link in self.links:
            for name in vars(total):
                setattr(total, name, getattr(total, name) + getattr(link.endpoint.counts, name))
        return total

    def send(self, system: int, message: Message) -> None:
        """Send a message to a connected vehicle."""
        link, address = self._routes[system]
        self._send(link, link.endpoint.peer(address), message, system)

    def send_heartbeats(self) -> None:
        """Send a heartbeat on every link, and measure round trips."""
        heartbeat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        )
        now = asyncio.get_running_loop().time()
        timesync = mavlink.MAVLink_timesync_message(0, timesync_stamp(now))
        for vehicle in self.vehicles.values():
            vehicle.link.look(now)
            vehicle.link.ask(now)
        for link in self.links:
            for peer in list(link.endpoint.peers.values()):
                self._send(link, peer, heartbeat, 0)
                self._send(link, peer, timesync, 0)

    async def _run_heartbeats(self) -> None:
        while True:
            if self.heartbeats_enabled:
                self.send_heartbeats()
            await asyncio.sleep(HEARTBEAT_INTERVAL)

    def _send(self, link: GroundLink, peer: Peer, message: Message, system: int) -> None:
        packet = link.endpoint.pack(message, peer)
        link.endpoint.send_packet(packet, peer)
        self._notify(system, packet, is_sent=True)

    def _receive(self, link: GroundLink, message: Message, peer: Peer) -> None:
        system = message.get_srcSystem()
        if message.get_srcComponent() != AUTOPILOT_COMPONENT:
            return
        vehicle = self.vehicles.get(system) or self._add(link, message, peer)
        if vehicle is None:
            return
        if self._routes[system] != (link, peer.address) and not self._follow(vehicle, link, peer):
            return
        vehicle.note(message, peer.lost)
        self._notify(system, bytes(message.get_msgbuf()), is_sent=False)

    def _add(self, link: GroundLink, message: Message, peer: Peer) -> RemoteVehicle | None:
        """Add a new vehicle if the message is its heartbeat."""
        if message.get_type() != "HEARTBEAT" or message.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
            return None
        system = message.get_srcSystem()
        if not 0 < system < GROUND_SYSTEM or len(self.vehicles) >= CONNECTIONS_MAX:
            return None
        loop = asyncio.get_running_loop()
        host, port = peer.address
        self._routes[system] = (link, peer.address)
        vehicle = RemoteVehicle(
            system,
            f"{host}:{port}",
            is_local=_is_local(link, host),
            send=lambda message: self.send(system, message),
            clock=loop.time,
        )
        self.vehicles[system] = vehicle
        link.systems.add(system)
        return vehicle

    def _follow(self, vehicle: RemoteVehicle, link: GroundLink, peer: Peer) -> bool:
        """Accept a message from another address if the vehicle moved there; else record the address as a rival."""
        where = f"{peer.address[0]}:{peer.address[1]}"
        if asyncio.get_running_loop().time() - vehicle.last_received < MOVED_AFTER or where in vehicle.rivals:
            vehicle.rivals.add(where)
            return False
        before, _ = self._routes[vehicle.system]
        before.systems.discard(vehicle.system)
        link.systems.add(vehicle.system)
        self._routes[vehicle.system] = (link, peer.address)
        vehicle.where, vehicle.is_local = where, _is_local(link, peer.address[0])
        return True

    def _notify(self, system: int, packet: bytes, *, is_sent: bool) -> None:
        if self.observers:
            traffic = Traffic(asyncio.get_running_loop().time(), system, is_sent, packet)
            for observer in self.observers:
                observer(traffic)

    def _silent_links(self) -> list[GroundLink]:
        return [link for link in self.links if not link.systems]

    def _hint(self) -> str:
        """Possible reason for missing vehicles, in words."""
        counts = self.counts()
        reasons = collections.Counter({"unsigned or wrongly signed": counts.unsigned, "malformed": counts.malformed})
        hints = [f"{count} packets were {name}" for name, count in reasons.items() if count]
        return f" ({', '.join(hints)})" if hints else ""


def _is_local(link: GroundLink, host: str) -> bool:
    return Connection(link.connection.kind, host, 1).is_local


@contextlib.asynccontextmanager
async def vehicles_at(
    connections: Sequence[Connection],
    key: SigningKey | None = None,
    *,
    count: int | None = None,
    timeout: float = 10.0,
) -> AsyncIterator[tuple[GroundStation, list[RemoteVehicle]]]:
    """Open a ground station and connect all its vehicles; see `GroundStation` and `GroundStation.connect`."""
    async with GroundStation(connections, key) as ground:
        yield ground, await ground.connect(count=count, timeout=timeout)
