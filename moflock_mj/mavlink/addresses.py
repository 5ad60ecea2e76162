"""Where vehicles are: the texts of `--vehicles`."""

from __future__ import annotations

import ipaddress
import re
import socket
from typing import NamedTuple

from moflock_mj.errors import LinkError

KINDS = {"udp": "udpout", "udpout": "udpout", "udpin": "udpin", "tcp": "tcp"}
"""How a text may begin. udpout: we send first, to a vehicle that listens; udpin: we listen; tcp: we connect."""

CONNECTIONS_MAX = 250
"""As many as there are system ids for vehicles."""

_TCP_STEP = 10
"""Between the ports of two ArduPilot simulators, 5760 and 5770."""
_FORM = "it must be KIND:HOST:PORT or KIND:HOST:PORT-LAST with KIND one of udp, udpout, udpin, tcp"


class Connection(NamedTuple):
    """One end of a link: where a vehicle is, or where we wait for some.

    Attributes:
        kind: "udpout", "udpin" or "tcp".
        host: numeric address.
        port: from 1 to 65535.
    """

    kind: str
    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.kind}:{self.host}:{self.port}"

    @property
    def is_local(self) -> bool:
        """Whether it does not leave this machine."""
        return ipaddress.ip_address(self.host).is_loopback


def parse_vehicles(text: str) -> tuple[Connection, ...]:
    """Connections of a text such as udp:127.0.0.1:14600-14609,udpin:0.0.0.0:14550.

    Ports of a range count by 1; those of tcp by 10, as ArduPilot's simulators have them.

    Raises:
        LinkError: it is no such text, nobody knows the host, or a connection stands there twice.
    """
    connections = [connection for part in text.split(",") for connection in _parse_range(part.strip())]
    if len(connections) > CONNECTIONS_MAX:
        raise LinkError(f"vehicles: {len(connections)} connections; it must be at most {CONNECTIONS_MAX}")
    for number, connection in enumerate(connections):
        if connection in connections[:number]:
            raise LinkError(f"vehicles: {connection} stands there twice")
    return tuple(connections)


def _parse_range(text: str) -> list[Connection]:
    match = re.fullmatch(r"([a-z]+):([^:,]+):(\d{1,5})(?:-(\d{1,5}))?", text)
    if match is None or match[1] not in KINDS:
        raise LinkError(f"vehicles: {text!r} is none: {_FORM}")
    kind, host, first = KINDS[match[1]], match[2], int(match[3])
    last = int(match[4]) if match[4] else first
    step = _TCP_STEP if kind == "tcp" else 1
    if not 0 < first <= last < 65536:
        raise LinkError(f"vehicles: {text!r}: ports must be from 1 to 65535, the first not above the last")
    if (last - first) % step:
        raise LinkError(
            f"vehicles: {text!r}: tcp ports of a range are {step} apart, as ArduPilot's simulators have them"
        )
    try:
        numeric = socket.gethostbyname(host)
    except (OSError, UnicodeError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else "no name of a host"
        raise LinkError(f"vehicles: {host}: {reason}") from None
    return [Connection(kind, numeric, port) for port in range(first, last + 1, step)]
