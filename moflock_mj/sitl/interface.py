"""What the lock-step knows of one autopilot: whether it has given its outputs, and how to tell it its sensors."""

from __future__ import annotations

import abc
import dataclasses
import socket
from collections.abc import Callable
from typing import NamedTuple

from controllers.airframe import ROTORS
from moflock_mj.errors import LinkError
from moflock_mj.mavlink.frames import Origin
from moflock_mj.sitl.sensors import Motion, Surroundings

HOST = "127.0.0.1"
"""Where the physics listens: autopilots run on this machine."""

STILL = (0.0,) * ROTORS
"""Outputs of motors that stand."""


class Reading(NamedTuple):
    """What the sensors of all drones tell after a step.

    Attributes:
        time: s, simulated.
        motion: of inertial sensors and GPS.
        surroundings: of magnetometers and barometers; read for those who ask.
        origin: of the world on the globe.
    """

    time: float
    motion: Motion
    surroundings: Callable[[], Surroundings]
    origin: Origin


@dataclasses.dataclass(kw_only=True)
class Counts:
    """What a link has seen.

    Attributes:
        received: outputs that were taken.
        dropped: packets that are none of the protocol's, are out of bounds, or come from elsewhere.
        restarts: times that an autopilot began anew.
    """

    received: int = 0
    dropped: int = 0
    restarts: int = 0


class AutopilotInterface(abc.ABC):
    """One autopilot's side of the lock-step.

    Args:
        number: of its drone, from 0.

    Attributes:
        outputs: of motors 1 to 4, from 0 to 1, for the next step.
        ready: whether it has given them.
        present: whether the world waits for it; the lock-step says no for one that is silent.
        counts: what it has seen.
    """

    def __init__(self, number: int) -> None:
        self.number = number
        self.outputs: tuple[float, ...] = STILL
        self.ready = False
        self.present = False
        self.counts = Counts()

    @abc.abstractmethod
    def open(self, port: int) -> None:
        """Listen on a port of HOST; 0: any that is free.

        Raises:
            LinkError: the port is in use.
        """

    @property
    @abc.abstractmethod
    def port(self) -> int:
        """Where it listens."""

    @abc.abstractmethod
    def close(self) -> None:
        """Close all sockets."""

    @abc.abstractmethod
    def receive(self, timeout: float) -> None:
        """Take what has arrived, or what arrives first within `timeout`, s; sets `ready` and `outputs`."""

    @abc.abstractmethod
    def tell(self, reading: Reading) -> None:
        """Send the sensors after a step, and wait for the next outputs from then on."""


def listening(kind: socket.SocketKind, name: str, port: int) -> socket.socket:
    """A socket that is bound to a port of HOST.

    Args:
        kind: SOCK_DGRAM or SOCK_STREAM.
        name: of the protocol, for the error.
        port: 0: any that is free.

    Raises:
        LinkError: the port is in use.
    """
    opened = socket.socket(socket.AF_INET, kind)
    try:
        if kind == socket.SOCK_STREAM:
            # A server that has just ended must not block the next one for a minute.
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind((HOST, port))
    except (OSError, OverflowError) as problem:
        opened.close()
        raise LinkError(f"{name} {HOST}:{port}: {getattr(problem, 'strerror', None) or problem}") from None
    return opened
