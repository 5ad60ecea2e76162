"""Addresses of vehicles: the texts of `--vehicles`."""

from __future__ import annotations

import ipaddress
import re
import socket
from typing import NamedTuple

from moflock_mj.errors import LinkError

KINDS = {"udp": "udpout", "udpout": "udpout", "udpin": "udpin", "tcp": "tcp"}
"""Kinds of connections by their names. udpout sends first, to a vehicle that listens; udpin listens; tcp connects."""

CONNECTIONS_MAX = 250
"""Maximum number of connections: the number of system ids for vehicles."""

_TCP_STEP = 10
"""Difference between the ports of two ArduPilot simulators, such as 5760 and 5770."""
_FORM = "it must be KIND:HOST:PORT or KIND:HOST:PORT-LAST with KIND one of udp, udpout, udpin, tcp"


class Connection(NamedTuple):
    """One end of a link: the address of a vehicle, or the local address that listens for vehicles.

    Attributes:
        kind: "udpout", "udpin" or "tcp".
        host: numeric address.
        port: port, from 1 to 65535.
    """

    kind: str
    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.kind}:{self.host}:{self.port}"

    @property
    def is_local(self) -> bool:
        """Whether its packets stay on this machine."""
        return ipaddress.ip_address(self.host).is_loopback


def parse_vehicles(text: str) -> tuple[Connection, ...]:
    """Parse connections from a text such as udp:127.0.0.1:14600-14609,udpin:0.0.0.0:14550.

    Ports of a range differ by 1; those of tcp by 10, like the ports of ArduPilot's simulators.

    Raises:
        LinkError: the text has another form, a host cannot be resolved, or a connection is duplicated.
    """
    connections = [connection for part in text.split(",") for connection in _parse_range(part.strip())]
    if len(connections) > CONNECTIONS_MAX:
        raise LinkError(f"vehicles: {len(connections)} connections; it must be at most {CONNECTIONS_MAX}")
    for number, connection in enumerate(connections):
        if connection in connections[:number]:
            raise LinkError(f"vehicles: {connection} is duplicated: each connection must be given once")
    return tuple(connections)


def _parse_range(text: str) -> list[Connection]:
    match = re.fullmatch(r"([a-z]+):([^:,]+):(\d{1,5})(?:-(\d{1,5}))?", text)
    if match is None or match[1] not in KINDS:
        raise LinkError(f"vehicles: {text!r} is invalid: {_FORM}")
    kind, host, first = KINDS[match[1]], match[2], int(match[3])
    last = int(match[4]) if match[4] else first
    step = _TCP_STEP if kind == "tcp" else 1
    if not 0 < first <= last < 65536:
        raise LinkError(f"vehicles: {text!r}: ports must be from 1 to 65535, the first not above the last")
    if (last - first) % step:
        raise LinkError(
            f"vehicles: {text!r}: the tcp ports of a range must be {step} apart, like those of ArduPilot's simulators"
        )
    try:
        numeric = socket.gethostbyname(host)
    except (OSError, UnicodeError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else "not a host name"
        raise LinkError(f"vehicles: {host}: {reason}") from None
    return [Connection(kind, numeric, port) for port in range(first, last + 1, step)]
