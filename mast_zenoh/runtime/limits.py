"""Limits on what waits in a node's process: so many messages and bytes of each source, in each place.

A source is the node that publishes a key's wire. A hostile source uses up its own room and nobody else's. The sum of
all places, for one source, keeps a process below 400 MB. Forty agents with 60 tracks each use at most three quarters of
any of it (tests/runtime/test_limits.py).
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

_MIB = 1 << 20


class Limit(NamedTuple):
    """How many messages, and how many bytes of them, of one source may wait in one place."""

    messages: int
    bytes: int

    def __str__(self) -> str:
        return f"{self.messages} messages or {self.bytes // _MIB} MiB"


#: Messages that wait for the clock of their step. The driver waits for everyone, so there is one frame of them.
HELD = Limit(10_000, 32 * _MIB)
#: Messages of an epoch that this node has not entered yet: those of the moment between two control messages.
EARLY = Limit(10_000, 32 * _MIB)
#: Messages in the inbox. Listeners may fall behind by `driver.SETTLE_EVERY` frames, of 1.8 MB for the largest source.
INBOX = Limit(20_000, 128 * _MIB)
#: Messages that leave later. A link that delays a picture of 300 objects by half a minute keeps 68 MB of them.
DELAYED = Limit(10_000, 128 * _MIB)


class Room:
    """Accounts for what waits in one place."""

    def __init__(self, limit: Limit) -> None:
        self.limit = limit
        self._messages: Counter[str] = Counter()
        self._bytes: Counter[str] = Counter()

    def take(self, source: str, size: int) -> bool:
        """Make room for a message of `size` bytes; False when its source has none left."""
        messages, n_bytes = self._messages[source] + 1, self._bytes[source] + size
        if messages > self.limit.messages or n_bytes > self.limit.bytes:
            return False
        self._messages[source], self._bytes[source] = messages, n_bytes
        return True

    def free(self, source: str, size: int) -> None:
        """A message that `take` made room for waits no longer."""
        self._messages[source] -= 1
        self._bytes[source] -= size
