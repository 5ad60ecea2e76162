"""MAVLink over TCP: extraction of packets from a stream of bytes."""

from __future__ import annotations

import asyncio
from typing import Any

from moflock_mj.errors import LinkError
from moflock_mj.mavlink.endpoint import Address, Endpoint, frame_length

_MARKER = b"\xfd"
_LONGEST = 280
"""Maximum length of a signed MAVLink 2 packet, bytes."""


class StreamLink(asyncio.Protocol):
    """TCP connection in place of an endpoint's UDP socket.

    Bytes that do not begin a packet are skipped up to the next marker, and counted as malformed once.

    Args:
        endpoint: endpoint that uses the connection.
        address: address of the other end, which identifies the endpoint's peer.
    """

    def __init__(self, endpoint: Endpoint, address: Address) -> None:
        self._endpoint = endpoint
        self._address = address
        self._pending = bytearray()
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: Any) -> None:
        self._transport = transport
        self._endpoint.connection_made(self)

    def data_received(self, data: bytes) -> None:
        """Deliver all complete packets."""
        pending = self._pending
        pending += data
        while pending:
            start = pending.find(_MARKER)
            if start:
                self._endpoint.counts.malformed += 1
                del pending[: start if start > 0 else len(pending)]
                continue
            length = frame_length(pending, 0)
            if length:
                self._endpoint.datagram_received(bytes(pending[:length]), self._address)
                del pending[:length]
            elif len(pending) >= _LONGEST or (len(pending) > 2 and pending[2] & ~1):
                del pending[:1]
            else:
                return

    def sendto(self, packet: bytes, _: Address) -> None:
        """Send a packet, unless the connection is closing."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(packet)

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()


async def open_stream(endpoint: Endpoint, address: Address) -> None:
    """Connect an endpoint by TCP.

    Raises:
        LinkError: the connection is refused or fails.
    """
    try:
        await asyncio.get_running_loop().create_connection(lambda: StreamLink(endpoint, address), *address)
    except OSError as problem:
        raise LinkError(f"TCP {address[0]}:{address[1]}: {problem.strerror or problem}") from None
