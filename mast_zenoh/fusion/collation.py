"""Bringing messages of many publishers together by frame: the one structure that every node uses for that.

What comes out is a function of the set of messages that came in, whatever their order. Deadlines are judged when
the next clock arrives, never by a timer.
"""

from __future__ import annotations

import heapq
from collections.abc import Hashable, Iterable, Iterator
from typing import Generic, TypeVar

Member = TypeVar("Member", bound=Hashable)
Item = TypeVar("Item")


class Gather(Generic[Member, Item]):
    """Collects one item a frame from each expected member; a frame is ready when all of them are there.

    `patience` frames after its own, a frame that is not complete is given up as it is: `expired` returns it.
    """

    def __init__(self, expected: Iterable[Member] = (), patience: int = 0) -> None:
        self.expected: set[Member] = set(expected)
        self.patience = patience
        self.duplicates = 0
        self._frames: dict[int, dict[Member, Item]] = {}
        self._done_through = -1
        self._complete: set[int] = set()

    def add(self, frame: int, member: Member, item: Item) -> dict[Member, Item] | None:
        """All items of `frame` if this one completes it, else None. Late and second items are left out."""
        if frame <= self._done_through:
            return None
        if frame in self._complete:
            self.duplicates += 1
            return None
        items = self._frames.setdefault(frame, {})
        if member in items:
            self.duplicates += 1
            return None
        items[member] = item
        if self.expected <= items.keys():
            self._complete.add(frame)
            return self._frames.pop(frame)
        return None

    def expired(self, clock_frame: int) -> Iterator[tuple[int, dict[Member, Item]]]:
        """Frames that have waited beyond their patience when the clock of `clock_frame` arrives, oldest first."""
        limit = clock_frame - self.patience - 1
        for frame in sorted(frame for frame in self._frames if frame <= limit):
            yield frame, self._frames.pop(frame)
        self._done_through = max(self._done_through, limit)
        self._complete = {frame for frame in self._complete if frame > self._done_through}

    def flush(self) -> Iterator[tuple[int, dict[Member, Item]]]:
        """Everything that is left, oldest first."""
        for frame in sorted(self._frames):
            yield frame, self._frames.pop(frame)


class LatestBefore(Generic[Item]):
    """Keeps the newest items by frame, and answers what was the newest of the frames before a given one.

    Asking for an *earlier* frame makes the answer independent of whether this frame's item has come already.
    """

    def __init__(self, keep: int = 8) -> None:
        self._keep = keep
        self._items: dict[int, Item] = {}

    def add(self, frame: int, item: Item) -> None:
        """Take the item of a frame; of two for one frame the first stays."""
        self._items.setdefault(frame, item)
        if len(self._items) > self._keep:
            del self._items[min(self._items)]

    def get(self, frame: int) -> tuple[int, Item] | None:
        """(frame, item) of the newest frame before `frame`, or None."""
        earlier = [f for f in self._items if f < frame]
        return (newest := max(earlier), self._items[newest]) if earlier else None


class CollationBuffer(Generic[Item]):
    """Per-agent min-heaps by time, bounded: a full one drops its *oldest* item.

    capacity: items kept per agent
    """

    def __init__(self, capacity: int = 10) -> None:
        self.capacity = capacity
        self.dropped = 0
        self.late: dict[str, int] = {}
        self._heaps: dict[str, list[tuple[int, int, Item]]] = {}
        self._emitted_ns = -1
        self._count = 0  # breaks ties, so that items are never compared

    def push(self, agent: str, time_ns: int, item: Item) -> bool:
        """Take an item; False (and counted as late) when the batch of its time has been emitted already."""
        if time_ns <= self._emitted_ns:
            self.late[agent] = self.late.get(agent, 0) + 1
            return False
        heap = self._heaps.setdefault(agent, [])
        heapq.heappush(heap, (time_ns, self._count, item))
        self._count += 1
        if len(heap) > self.capacity:
            heapq.heappop(heap)
            self.dropped += 1
        return True

    def present(self, time_ns: int) -> set[str]:
        """The agents that have an item of exactly `time_ns`."""
        return {agent for agent, heap in self._heaps.items() if any(entry[0] == time_ns for entry in heap)}

    def pop(self, time_ns: int) -> dict[str, tuple[int, Item]]:
        """(time, item) of every agent's newest item up to `time_ns`. They and older ones go; later ones are late."""
        batch: dict[str, tuple[int, Item]] = {}
        for agent in sorted(self._heaps):
            heap = self._heaps[agent]
            while heap and heap[0][0] <= time_ns:
                item_ns, _, item = heapq.heappop(heap)
                batch[agent] = (item_ns, item)
            if not heap:
                del self._heaps[agent]
        self._emitted_ns = max(self._emitted_ns, time_ns)
        return batch
