"""Bringing messages of many publishers together by frame: the one structure that every node uses for that.

What comes out is a function of the set of messages that came in, whatever their order. Deadlines are judged when
the next clock arrives, never by a timer.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Hashable, Iterable, Iterator, Set
from typing import Generic, TypeVar

Member = TypeVar("Member", bound=Hashable)
Item = TypeVar("Item")

#: s, default: the newest message of a publisher counts for so long when no newer one arrives.
MAX_AGE_S = 0.25

_REMEMBERED = 64  #: frames of an agent's words by which a duplicate is known


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


class LatestBefore(Generic[Item]):
    """Keeps items by the frame in which they came, and answers which was the newest before a given frame.

    Asking for an *earlier* frame makes the answer independent of whether this frame's item has come already.
    """

    def __init__(self, keep: int = 8) -> None:
        self._keep = keep
        self._items: dict[int, tuple[int, Item]] = {}

    def add(self, frame: int, item: Item, about: int | None = None) -> None:
        """Take an item that has come in a frame; of two the one about the later frame stays, of equals the first.

        about: the frame that it is about, if that is another: it may have been held up, or overtaken
        """
        about = frame if about is None else about
        if frame in self._items and self._items[frame][0] >= about:
            return
        self._items[frame] = about, item
        if len(self._items) > self._keep:
            del self._items[min(self._items)]

    def get(self, frame: int) -> tuple[int, Item] | None:
        """(frame, item): of those that came before `frame` the one about the latest, and when it came; or None.

        Of several about one frame the first that came counts.
        """
        earlier = [(about, -came) for came, (about, _) in self._items.items() if came < frame]
        if not earlier:
            return None
        came = -max(earlier)[1]
        return came, self._items[came][1]


class CollationBuffer(Generic[Item]):
    """Per-agent min-heaps by frame, bounded: a full one drops its *oldest* item.

    An agent has one word a frame: the first. A second one is a duplicate, also when the first has been used already.

    capacity: items kept per agent
    """

    def __init__(self, capacity: int = 10) -> None:
        self.capacity = capacity
        self.dropped = 0
        self.late: dict[str, int] = {}
        self.duplicates = 0
        self._heaps: dict[str, list[tuple[int, Item]]] = {}
        self._spoken: dict[str, deque[int]] = {}  # the frames of the last words of each
        self._emitted = -1

    def push(self, agent: str, frame: int, item: Item) -> bool:
        """Take an item; False when it is a duplicate, or (counted as late) the batch of its frame has been emitted."""
        spoken = self._spoken.setdefault(agent, deque(maxlen=_REMEMBERED))
        heap = self._heaps.get(agent, [])
        if frame in spoken or any(entry[0] == frame for entry in heap):
            self.duplicates += 1
            return False
        spoken.append(frame)
        if frame <= self._emitted:
            self.late[agent] = self.late.get(agent, 0) + 1
            return False
        self._heaps[agent] = heap
        heapq.heappush(heap, (frame, item))  # no two are of the same frame, so that items are never compared
        if len(heap) > self.capacity:
            heapq.heappop(heap)
            self.dropped += 1
        return True

    def present(self, frame: int) -> set[str]:
        """The agents whose word of this very frame is there."""
        return {agent for agent, heap in self._heaps.items() if any(entry[0] == frame for entry in heap)}

    def complete(self, frame: int, agents: Set[str]) -> bool:
        """Whether the word of this very frame is there of all these agents."""
        return agents <= self._heaps.keys() and agents <= self.present(frame)

    def pop(self, frame: int) -> dict[str, Item]:
        """Every agent's newest item up to `frame`. They and older ones go; what comes of those frames now is late."""
        batch: dict[str, Item] = {}
        for agent in sorted(self._heaps):
            heap = self._heaps[agent]
            while heap and heap[0][0] <= frame:
                _, batch[agent] = heapq.heappop(heap)
            if not heap:
                del self._heaps[agent]
        self._emitted = max(self._emitted, frame)
        return batch
