"""MAVLink 2 signing (https://mavlink.io/en/guide/message_signing.html): key, clock, and check of received packets.

The key is never given on the command line, where every user of the machine could read it.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import stat
import time
from collections.abc import Callable
from pathlib import Path

from moflock_mj.errors import LinkError

KEY_VARIABLE = "MOFLOCK_SIGNING_KEY"
"""Environment variable with the key."""

_EPOCH = 1_420_070_400
"""Unix time of 2015-01-01 00:00 UTC, the start of the signatures' time in units of 10 us."""
_PER_SECOND = 100_000
_NEW_STREAM_LATE = 60 * _PER_SECOND
"""Maximum delay of a sender's first signature behind our clock: the protocol's minute."""
_AHEAD = 86_400 * _PER_SECOND
"""Maximum lead of a signature over our clock, since one wrong clock would permanently advance all others."""


class SigningKey:
    """Signing key of 32 bytes, which `repr` does not show."""

    def __init__(self, secret: bytes) -> None:
        if len(secret) != 32:
            raise LinkError(f"signing key: {len(secret)} bytes: it must be 32")
        self.secret = secret

    @classmethod
    def from_text(cls, text: str, source: str) -> SigningKey:
        """Parse 64 hexadecimal digits, or take the SHA-256 of a pass phrase as MAVProxy and Mission Planner do.

        Raises:
            LinkError: the text is shorter than 8 characters.
        """
        text = text.strip()
        if re.fullmatch(r"[0-9a-fA-F]{64}", text):
            return cls(bytes.fromhex(text))
        if len(text) < 8:
            raise LinkError(f"{source}: a signing key of {len(text)} characters: it must have at least 8")
        return cls(hashlib.sha256(text.encode()).digest())


def find_key(path: Path | None) -> SigningKey | None:
    """Key from a file or from the environment variable MOFLOCK_SIGNING_KEY; None if there is none.

    Args:
        path: file with 64 hexadecimal digits or a pass phrase, readable by its owner only; None for the variable.

    Raises:
        LinkError: the file cannot be read, is readable by others, or contains no key.
    """
    if path is None:
        text = os.environ.get(KEY_VARIABLE)
        return None if text is None else SigningKey.from_text(text, KEY_VARIABLE)
    try:
        # Without O_NONBLOCK, opening a named pipe would block until a writer opens it.
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise LinkError(f"key file {path}: it must be a regular file")
            if status.st_mode & 0o077 or status.st_uid != os.geteuid():
                permissions = f"{stat.S_IMODE(status.st_mode):o}"
                raise LinkError(
                    f"key file {path}: permissions {permissions}: they must be 600, and the file yours (chmod 600)"
                )
            text = file.read(4096).decode()
    except OSError as problem:
        raise LinkError(f"key file {path}: {problem.strerror}") from None
    except UnicodeDecodeError:
        raise LinkError(f"key file {path}: it must be a text file") from None
    return SigningKey.from_text(text, f"key file {path}")


class SigningClock:
    """Strictly increasing clock of the signatures in units of 10 us, one for all links of a process.

    Args:
        now: function that returns Unix time, s.
    """

    def __init__(self, now: Callable[[], float] = time.time) -> None:
        self._now = now
        self._latest = 0

    def time(self) -> int:
        """Current time of the clock."""
        return max(self._latest, int((self._now() - _EPOCH) * _PER_SECOND))

    def take(self) -> int:
        """Return the time for the next signature, later than all before it."""
        self._latest = max(self.time(), self._latest + 1)
        return self._latest

    def learn(self, timestamp: int) -> None:
        """Advance to the clock of an authenticated sender."""
        self._latest = max(self._latest, timestamp)


class SignatureCheck:
    """Check of the signatures that one endpoint receives.

    Unlike pymavlink's check, it verifies the signature before it uses the time, so that a forged packet from the future
    has no effect. A stream (link, system, component) belongs to the endpoint and not to an address, so that a replayed
    packet from another port is also recognized as old.
    """

    def __init__(self, key: SigningKey, clock: SigningClock) -> None:
        self._key = key
        self._clock = clock
        self._newest: dict[tuple[int, int, int], int] = {}

    def accepts(self, frame: bytes | bytearray, system: int, component: int) -> bool:
        """Whether a whole signed packet is authentic and newer than all before it.

        Args:
            frame: the packet, which ends with a signature of 13 bytes.
            system: system id of the sender.
            component: component id of the sender.
        """
        if not hmac.compare_digest(hashlib.sha256(self._key.secret + frame[:-6]).digest()[:6], bytes(frame[-6:])):
            return False
        timestamp = int.from_bytes(frame[-12:-6], "little")
        now = self._clock.time()
        stream = (frame[-13], system, component)
        earliest = self._newest.get(stream, now - _NEW_STREAM_LATE - 1) + 1
        if not earliest <= timestamp <= now + _AHEAD:
            return False
        self._newest[stream] = timestamp
        self._clock.learn(timestamp)
        return True
