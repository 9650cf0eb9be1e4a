"""Waiting messages in a node's process: limits per source and buffer, and a buffer of items that are due later.

A source is the node that publishes a key's wire. A hostile source can only use up its own room. The limits of all
buffers together keep a process below 400 MB for one source. Forty agents with 60 tracks each use at most three quarters
of any limit (tests/runtime/test_limits.py).
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator
from typing import Generic, NamedTuple, TypeVar

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


Item = TypeVar("Item")


class WaitingItems(Generic[Item]):
    """Items that wait until they are due, limited by source; `len` is their number.

    Items due at the same time are ordered by `rank`, items of equal rank by insertion.
    """

    def __init__(self, limit: Limit) -> None:
        self._heap: list[tuple[int, int, int, str, int, Item]] = []
        self._count = 0  # breaks ties, so that items are never compared
        self._room = Room(limit)

    def push(self, due: int, rank: int, item: Item, source: str, size: int) -> bool:
        """Keep an item of `size` bytes until `due`; False if its source has no room left.

        due: a step or ns, the unit that `pop` gets
        """
        if not self._room.take(source, size):
            return False
        heapq.heappush(self._heap, (due, rank, self._count, source, size, item))
        self._count += 1
        return True

    def pop(self, now: int) -> Iterator[Item]:
        """Remove and yield all items due by `now`, including those pushed meanwhile."""
        while self._heap and self._heap[0][0] <= now:
            _, _, _, source, size, item = heapq.heappop(self._heap)
            self._room.free(source, size)
            yield item

    @property
    def due(self) -> int | None:
        """When the next item is due; None if there is none."""
        return self._heap[0][0] if self._heap else None

    def __len__(self) -> int:
        return len(self._heap)
