"""Messages that leave later than they could, in the order in which they are due."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Delayed(Generic[Item]):
    """Holds items until they are due. Those due at once come out by `rank`, those of one rank as they went in."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, int, Item]] = []
        self._count = 0  # breaks ties, so that items are never compared

    def push(self, due: int, rank: int, item: Item) -> None:
        """Hold an item until `due` (a step, or ns: whatever `pop` is told)."""
        heapq.heappush(self._heap, (due, rank, self._count, item))
        self._count += 1

    def pop(self, now: int) -> Iterator[Item]:
        """All items that are due by now; what goes in meanwhile comes out as well, if it is due."""
        while self._heap and self._heap[0][0] <= now:
            yield heapq.heappop(self._heap)[-1]

    @property
    def due(self) -> int | None:
        """When the next item is due; None when there is none."""
        return self._heap[0][0] if self._heap else None

    def __len__(self) -> int:
        return len(self._heap)
