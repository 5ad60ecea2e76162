"""Interface of the lock-step to one autopilot: motor outputs in, sensor readings out."""

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
"""Address on which the physics listens; autopilots run on this machine."""

STILL = (0.0,) * ROTORS
"""Outputs of stopped motors."""


class Reading(NamedTuple):
    """Sensor readings of all drones after a step.

    Attributes:
        time: simulated time, s.
        motion: readings of inertial sensors and GPS.
        surroundings: function that reads magnetometers and barometers.
        origin: geographic position of the world frame's origin.
    """

    time: float
    motion: Motion
    surroundings: Callable[[], Surroundings]
    origin: Origin


@dataclasses.dataclass(kw_only=True)
class Counts:
    """Counts of a link.

    Attributes:
        received: accepted outputs.
        dropped: packets that do not belong to the protocol, are out of bounds, or come from another sender.
        restarts: restarts of the autopilot.
    """

    received: int = 0
    dropped: int = 0
    restarts: int = 0


class AutopilotInterface(abc.ABC):
    """Link of the lock-step to one autopilot.

    Args:
        number: number of the drone, from 0.

    Attributes:
        outputs: outputs of motors 1 to 4 for the next step, from 0 to 1.
        ready: whether the outputs have arrived.
        present: whether the simulation waits for this autopilot; the lock-step clears it for a silent one.
        counts: counts of the link.
    """

    def __init__(self, number: int) -> None:
        self.number = number
        self.outputs: tuple[float, ...] = STILL
        self.ready = False
        self.present = False
        self.counts = Counts()

    @abc.abstractmethod
    def open(self, port: int) -> None:
        """Listen on a port of HOST; 0 for any free port.

        Raises:
            LinkError: the port is in use.
        """

    @property
    @abc.abstractmethod
    def port(self) -> int:
        """Port on which it listens."""

    @abc.abstractmethod
    def close(self) -> None:
        """Close all sockets."""

    @abc.abstractmethod
    def receive(self, timeout: float) -> None:
        """Process what has arrived, or arrives first within `timeout`, s; sets `ready` and `outputs`."""

    @abc.abstractmethod
    def send_reading(self, reading: Reading) -> None:
        """Send the sensor readings of a step, and expect the next outputs."""


def listening(kind: socket.SocketKind, name: str, port: int) -> socket.socket:
    """Open a socket that is bound to a port of HOST.

    Args:
        kind: SOCK_DGRAM or SOCK_STREAM.
        name: name of the protocol, for the error.
        port: port; 0 for any free port.

    Raises:
        LinkError: the port is in use.
    """
    opened = socket.socket(socket.AF_INET, kind)
    try:
        if kind == socket.SOCK_STREAM:
            # Without SO_REUSEADDR, a server that has just ended blocks the port for a minute.
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind((HOST, port))
    except (OSError, OverflowError) as problem:
        opened.close()
        raise LinkError(f"{name} {HOST}:{port}: {getattr(problem, 'strerror', None) or problem}") from None
    return opened
