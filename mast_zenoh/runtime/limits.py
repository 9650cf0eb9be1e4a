"""Limits on waiting messages in a node's process, per source and buffer.

A source is the node that publishes a key's wire. A hostile source can only use up its own room. The limits of all
buffers together keep a process below 400 MB for one source. Forty agents with 60 tracks each use at most three quarters
of any limit (tests/runtime/test_limits.py).
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

_MIB = 1 << 20


class Limit(NamedTuple):
    """Maximum number and total bytes of waiting messages of one source in one buffer."""

    messages: int
    bytes: int

    def __str__(self) -> str:
        return f"{self.messages} messages or {self.bytes // _MIB} MiB"


#: Messages that wait for the clock of their step: one frame of them, because the driver waits for all nodes.
HELD = Limit(10_000, 32 * _MIB)
#: Messages of an epoch that this node has not entered yet: messages sent while the epoch message is in transit.
EARLY = Limit(10_000, 32 * _MIB)
#: Messages in the inbox. Listeners may fall behind by `pacer.SETTLE_EVERY` frames, of 1.8 MB for the largest source.
INBOX = Limit(20_000, 128 * _MIB)
#: Delayed messages. A link that delays a picture of 300 objects by half a minute keeps 68 MB of them.
DELAYED = Limit(10_000, 128 * _MIB)


class Room:
    """Accounts for the waiting messages in one buffer, by source."""

    def __init__(self, limit: Limit) -> None:
        self.limit = limit
        self._messages: Counter[str] = Counter()
        self._bytes: Counter[str] = Counter()

    def take(self, source: str, size: int) -> bool:
        """Reserve room for a message of `size` bytes; False if its source has none left."""
        messages, n_bytes = self._messages[source] + 1, self._bytes[source] + size
        if messages > self.limit.messages or n_bytes > self.limit.bytes:
            return False
        self._messages[source], self._bytes[source] = messages, n_bytes
        return True

    def free(self, source: str, size: int) -> None:
        """Release the room that `take` reserved for a message."""
        self._messages[source] -= 1
        self._bytes[source] -= size
