"""A queue of delayed items, ordered by due time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Delayed(Generic[Item]):
    """Holds items until they are due.

    Items due at the same time are ordered by `rank`, items of equal rank by insertion.
    """

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, int, Item]] = []
        self._count = 0  # breaks ties, so that items are never compared

    def push(self, due: int, rank: int, item: Item) -> None:
        """Hold an item until `due` (a step or ns, the unit that `pop` gets)."""
        heapq.heappush(self._heap, (due, rank, self._count, item))
        self._count += 1

    def pop(self, now: int) -> Iterator[Item]:
        """Remove and yield all items due by `now`, including those pushed meanwhile."""
        while self._heap and self._heap[0][0] <= now:
            yield heapq.heappop(self._heap)[-1]

    @property
    def due(self) -> int | None:
        """When the next item is due; None if there is none."""
        return self._heap[0][0] if self._heap else None

    def __len__(self) -> int:
        return len(self._heap)
