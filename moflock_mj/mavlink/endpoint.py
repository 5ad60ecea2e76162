"""A MAVLink 2 endpoint over UDP, for vehicles and ground stations.

Every datagram is untrusted until it is checked: whole packets of MAVLink 2, a correct checksum, a correct signature if
links are signed, and this system as the target. A packet that fails is dropped and only counted.
"""

from __future__ import annotations

import asyncio
import dataclasses
import struct
from collections.abc import Callable
from typing import Any

from moflock_mj.errors import LinkError
from moflock_mj.mavlink.dialect import AUTOPILOT_COMPONENT, Message, mavlink
from moflock_mj.mavlink.signing import SignatureCheck, SigningClock, SigningKey

Address = tuple[str, int]
"""Host and port."""

PEERS_MAX = 16
"""Maximum number of peers of a vehicle's endpoint; a further one replaces the one that was silent longest."""

_MARKER = 0xFD
_HEADER = 10
_CHECKSUM = 2
_SIGNATURE = 13
_SIGNED = 0x01
_SOURCES_MAX = 256
"""Maximum number of senders behind one address whose sequences are tracked."""


@dataclasses.dataclass(kw_only=True)
class Counts:
    """Packet counts of an endpoint.

    Attributes:
        received: delivered packets.
        unknown: packets of kinds that this dialect does not have, for example of newer firmware; not checkable.
        malformed: datagrams or parts of one that are not a MAVLink 2 packet, wrong checksums included.
        unsigned: packets without a valid and recent signature, if links are signed.
        foreign: packets with another target system or component, or with this system's own id as the sender.
        lost: packets missing in the senders' sequences.
        sent: sent packets.
    """

    received: int = 0
    unknown: int = 0
    malformed: int = 0
    unsigned: int = 0
    foreign: int = 0
    lost: int = 0
    sent: int = 0

    @property
    def dropped(self) -> int:
        """Number of invalid packets."""
        return self.malformed + self.unsigned + self.foreign


class Peer:
    """The other end of a link: its address, and the sequence numbers of packets to and from it.

    Attributes:
        address: host and port.
        lost: number of packets missing in the sender's sequence before the latest delivered packet.
    """

    def __init__(self, address: Address, packer: Any) -> None:
        self.address = address
        self.lost = 0
        self._packer = packer
        self._sequences: dict[tuple[int, int], int] = {}

    def count_lost(self, system: int, component: int, sequence: int) -> None:
        """Update `lost` for a sender's packet; it is 0 for a sender's first packet and after a restart."""
        source = (system, component)
        before = self._sequences.get(source)
        self.lost = 0
        if before is None and len(self._sequences) >= _SOURCES_MAX:
            return
        self._sequences[source] = sequence
        lost = 0 if before is None else (sequence - before - 1) % 256
        self.lost = lost if lost < 128 else 0

    def go_on(self, system: int, component: int, sequence: int) -> None:
        """Count a packet that is not delivered, and may be unchecked: it can only continue a known sequence."""
        source = (system, component)
        before = self._sequences.get(source)
        if before is not None and sequence == (before + 1) % 256:
            self._sequences[source] = sequence


class _Decoder(mavlink.MAVLink):  # type: ignore[misc]
    """Decoder of pymavlink with `SignatureCheck` in place of its own check."""

    def __init__(self, check: SignatureCheck | None) -> None:
        super().__init__(None)
        self._check = check
        if check is not None:
            self.signing.secret_key = b"kept by the check"

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:
        return self._check is not None and self._check.accepts(msgbuf, srcSystem, srcComponent)


class Endpoint(asyncio.DatagramProtocol):
    """A MAVLink 2 endpoint of one system on one UDP socket.

    Args:
        system: own system id.
        receive: callback that receives each valid message and the peer that sent it.
        component: own component id.
        key: signing key; unsigned packets are then dropped. None for unsigned links.
        clock: clock of the signatures, one for all endpoints of the process.
        peers_max: maximum number of peers; a further one replaces the one that was silent longest.
    """

    def __init__(
        self,
        system: int,
        receive: Callable[[Message, Peer], None],
        *,
        component: int = AUTOPILOT_COMPONENT,
        key: SigningKey | None = None,
        clock: SigningClock | None = None,
        peers_max: int = PEERS_MAX,
    ) -> None:
        self.system = system
        self.component = component
        self.counts = Counts()
        self.peers: dict[Address, Peer] = {}
        """Peers by address; the one that was silent longest comes first."""
        self._receive = receive
        self._peers_max = peers_max
        self._key = key
        self._clock = clock or SigningClock()
        self._decoder = _Decoder(SignatureCheck(key, self._clock) if key else None)
        self._transport: asyncio.DatagramTransport | None = None

    async def open(self, host: str = "127.0.0.1", port: int = 0) -> Address:
        """Bind the socket; returns its address.

        Raises:
            LinkError: the address is in use, or does not belong to this machine.
        """
        loop = asyncio.get_running_loop()
        try:
            transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=(host, port))
        except (OSError, OverflowError) as problem:
            reason = getattr(problem, "strerror", None) or str(problem)
            raise LinkError(f"UDP {host}:{port}: {reason}") from None
        bound: tuple[Any, ...] = transport.get_extra_info("sockname")
        return bound[0], bound[1]

    def connection_made(self, transport: Any) -> None:
        """Use this transport from now on."""
        self._transport = transport

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def rename(self, system: int) -> None:
        """Use another system id from now on."""
        self.system = system
        for peer in self.peers.values():
            peer._packer.srcSystem = system

    def peer(self, address: Address) -> Peer:
        """Return the peer at an address; create it if it is new."""
        peer = self.peers.pop(address, None)
        if peer is None:
            packer = mavlink.MAVLink(None, srcSystem=self.system, srcComponent=self.component)
            if self._key is not None:
                packer.signing.secret_key = self._key.secret
                packer.signing.sign_outgoing = True
            peer = Peer(address, packer)
            if len(self.peers) >= self._peers_max:
                del self.peers[next(iter(self.peers))]
        self.peers[address] = peer
        return peer

    def send(self, message: Message, peer: Peer) -> None:
        """Send a message to a peer."""
        self.send_packet(self.pack(message, peer), peer)

    def pack(self, message: Message, peer: Peer) -> bytes:
        """Encode a message with the next number of the peer's sequence."""
        packer = peer._packer
        if self._key is not None:
            packer.signing.timestamp = self._clock.take()
        packet: bytes = message.pack(packer)
        packer.seq = (packer.seq + 1) % 256
        return packet

    def send_packet(self, packet: bytes, peer: Peer) -> None:
        """Send bytes from `pack`."""
        if self._transport is not None:
            self.counts.sent += 1
            self._transport.sendto(packet, peer.address)

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        """Deliver the valid packets of a datagram."""
        address = (addr[0], addr[1])
        offset, end = 0, len(data)
        while offset < end:
            length = frame_length(data, offset)
            if not length:
                self.counts.malformed += 1
                return
            self._take(data[offset : offset + length], address)
            offset += length

    def error_received(self, exc: Exception) -> None:
        """Ignore the error: a peer that disappeared is not an error of this endpoint."""

    def _take(self, frame: bytes, address: Address) -> None:
        """Deliver one packet, if it is valid."""
        if self._key is not None and not frame[2] & _SIGNED:
            self.counts.unsigned += 1
            return
        signing = self._decoder.signing
        bad_signatures = signing.badsig_count
        try:
            message = self._decoder.decode(bytearray(frame))
        except (mavlink.MAVError, struct.error, ValueError):
            if signing.badsig_count > bad_signatures:
                self.counts.unsigned += 1
            else:
                self.counts.malformed += 1
            return
        if message.get_msgId() < 0 or message.get_type().startswith("UNKNOWN"):
            self._pass_over(frame, address)
            return
        system, component = message.get_srcSystem(), message.get_srcComponent()
        if (system, component) == (self.system, self.component):
            self.counts.foreign += 1
            return
        if not self._is_addressed(message):
            self.counts.foreign += 1
            self._go_on(frame, address)
            return
        peer = self.peer(address)
        self.counts.received += 1
        peer.count_lost(system, component, message.get_seq())
        self.counts.lost += peer.lost
        self._receive(message, peer)

    def _pass_over(self, frame: bytes, address: Address) -> None:
        """Count a packet of an unknown kind, which pymavlink has not checked, so that it is not counted as lost."""
        system, component = frame[5:7]
        if self._key is not None and not self._decoder.check_signature(bytearray(frame), system, component):
            self.counts.unsigned += 1
            return
        self.counts.unknown += 1
        self._go_on(frame, address)

    def _go_on(self, frame: bytes, address: Address) -> None:
        """Continue the sequence of a peer with a packet that is not delivered, so that it is not counted as lost."""
        if address in self.peers:
            sequence, system, component = frame[4:7]
            self.peers[address].go_on(system, component, sequence)

    def _is_addressed(self, message: Message) -> bool:
        """Whether the target of a message is this system or all systems."""
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self.system) and component in (0, self.component)


def frame_length(data: bytes | bytearray, offset: int) -> int:
    """Length of the packet at the offset, bytes; 0 if there is no whole packet."""
    if len(data) - offset < _HEADER + _CHECKSUM or data[offset] != _MARKER or data[offset + 2] & ~_SIGNED:
        return 0
    length = _HEADER + data[offset + 1] + _CHECKSUM + (_SIGNATURE if data[offset + 2] & _SIGNED else 0)
    return length if offset + length <= len(data) else 0
