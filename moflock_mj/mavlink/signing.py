"""MAVLink 2 signing: the key, the one clock of all links, and the check of what comes in.

https://mavlink.io/en/guide/message_signing.html has the protocol. The key never comes by the command line, where every
user of the machine could read it.
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
"""Environment variable that may hold the key."""

_EPOCH = 1_420_070_400
"""Unix time of 2015-01-01 00:00 UTC, from which signatures count time in units of 10 us."""
_PER_SECOND = 100_000
_NEW_STREAM_LATE = 60 * _PER_SECOND
"""How far behind our clock a sender's first signature may be: the protocol's minute."""
_AHEAD = 86_400 * _PER_SECOND
"""How far ahead of our clock a signature may be: one wrong clock would push all others' forward for good."""


class SigningKey:
    """The 32 secret bytes; not shown by `repr`."""

    def __init__(self, secret: bytes) -> None:
        if len(secret) != 32:
            raise LinkError(f"signing key: {len(secret)} bytes, must be 32")
        self.secret = secret

    @classmethod
    def from_text(cls, text: str, source: str) -> SigningKey:
        """A key of 64 hexadecimal digits, or the SHA-256 of a pass phrase, as MAVProxy and Mission Planner have it.

        Raises:
            LinkError: shorter than 8 characters.
        """
        text = text.strip()
        if re.fullmatch(r"[0-9a-fA-F]{64}", text):
            return cls(bytes.fromhex(text))
        if len(text) < 8:
            raise LinkError(f"{source}: a signing key of {len(text)} characters, must be at least 8")
        return cls(hashlib.sha256(text.encode()).digest())


def find_key(path: Path | None) -> SigningKey | None:
    """The key of a file, else that of the environment variable MOFLOCK_SIGNING_KEY, else None: links are not signed.

    Args:
        path: a file that only its owner may read, of 64 hexadecimal digits or a pass phrase.

    Raises:
        LinkError: the file cannot be read, others may read it, or it holds no key.
    """
    if path is None:
        text = os.environ.get(KEY_VARIABLE)
        return None if text is None else SigningKey.from_text(text, KEY_VARIABLE)
    try:
        # Without O_NONBLOCK a named pipe would keep us waiting for somebody to write into it.
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise LinkError(f"key file {path}: is no regular file")
            if status.st_mode & 0o077 or status.st_uid != os.geteuid():
                permissions = f"{stat.S_IMODE(status.st_mode):o}"
                raise LinkError(
                    f"key file {path}: its permissions are {permissions}, must be 600 and yours (chmod 600)"
                )
            text = file.read(4096).decode()
    except OSError as problem:
        raise LinkError(f"key file {path}: {problem.strerror}") from None
    except UnicodeDecodeError:
        raise LinkError(f"key file {path}: is no text") from None
    return SigningKey.from_text(text, f"key file {path}")


class SigningClock:
    """The signatures' time, in units of 10 us: one for all links of a process, and it never stands still or goes back.

    Args:
        now: tells Unix time, s.
    """

    def __init__(self, now: Callable[[], float] = time.time) -> None:
        self._now = now
        self._latest = 0

    def time(self) -> int:
        """Where the clock is."""
        return max(self._latest, int((self._now() - _EPOCH) * _PER_SECOND))

    def take(self) -> int:
        """A time for the next signature, later than all before it."""
        self._latest = max(self.time(), self._latest + 1)
        return self._latest

    def learn(self, timestamp: int) -> None:
        """Keep up with an authentic sender's clock."""
        self._latest = max(self._latest, timestamp)


class SignatureCheck:
    """Judges the signatures that one endpoint receives.

    Unlike pymavlink's, it looks at the signature before it believes the time: a forged packet from the future changes
    nothing. A stream (link, system, component) belongs to the endpoint and not to an address, so that a recorded packet
    is as old when it comes from another port.
    """

    def __init__(self, key: SigningKey, clock: SigningClock) -> None:
        self._key = key
        self._clock = clock
        self._newest: dict[tuple[int, int, int], int] = {}

    def accepts(self, frame: bytes | bytearray, system: int, component: int) -> bool:
        """Whether a whole signed packet is authentic and newer than all before it.

        Args:
            frame: the packet, with 13 bytes of signature at its end.
            system: its sender.
            component: its sender's component.
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
