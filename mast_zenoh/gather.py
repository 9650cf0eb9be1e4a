"""Collects messages from many publishers by frame.

The results depend on the set of messages, not on their order. Deadlines are checked when the next clock arrives, never
by a timer.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Hashable, Iterable, Iterator, MutableMapping, Set
from typing import Generic, TypeVar

import numpy as np

from mast_zenoh.arrays.states import Ints, ObjectStates

Member = TypeVar("Member", bound=Hashable)
Item = TypeVar("Item")

#: s, default age up to which the newest message of a publisher is used. A car's position that is predicted for longer
#: is too uncertain to be reported (a tracker's `max_std_m`).
MAX_AGE_S = 1.0

#: Limit on each value, in SI units, of a track that is collated: propagating a larger one could overflow.
MAX_TRACK_VALUE = 1e8

#: Number of recent frames of an agent that are remembered, to recognise duplicates.
_REMEMBERED = 64


class Gather(Generic[Member, Item]):
    """Collects one item per frame from each expected member.

    A frame is complete when all items have arrived. An incomplete frame expires after `patience` more frames: `expired`
    then yields it.
    """

    def __init__(self, expected: Iterable[Member] = (), patience: int = 0) -> None:
        self.expected: set[Member] = set(expected)
        self.patience = patience
        self.duplicates = 0
        self._frames: dict[int, dict[Member, Item]] = {}
        self._done_through = -1
        self._complete: set[int] = set()

    def add(self, frame: int, member: Member, item: Item) -> dict[Member, Item] | None:
        """Add an item; returns all items of `frame` if that completes it, else None.

        Late and duplicate items are dropped.
        """
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
        """Remove and yield the frames that have expired at `clock_frame`, oldest first."""
        limit = clock_frame - self.patience - 1
        for frame in sorted(frame for frame in self._frames if frame <= limit):
            yield frame, self._frames.pop(frame)
        self._done_through = max(self._done_through, limit)
        self._complete = {frame for frame in self._complete if frame > self._done_through}


class LatestBefore(Generic[Item]):
    """Keeps items by frame of arrival and returns the newest before a given frame.

    Items of the frame itself never count, so the result does not depend on whether they have already arrived.
    """

    def __init__(self, keep: int = 8) -> None:
        self._keep = keep
        self._items: dict[int, tuple[int, Item]] = {}

    def add(self, frame: int, item: Item, about: int | None = None) -> None:
        """Add an item that arrived in a frame.

        Of two items that arrived in the same frame, the one about the later frame is kept, or else the first. An item
        about a frame that has not begun is left out, so that it cannot stand before those that are about the present.

        about: the frame that it describes, if different because of a delay; in real time, it may be one ahead
        """
        about = frame if about is None else about
        if about > frame + 1:
            return
        if frame in self._items and self._items[frame][0] >= about:
            return
        self._items[frame] = about, item
        if len(self._items) > self._keep:
            del self._items[min(self._items)]

    def get(self, frame: int) -> tuple[int, Item] | None:
        """(frame of arrival, item) about the latest frame, among items from before `frame`.

        None if there are none. Of several about the same frame, the first to arrive counts.
        """
        earlier = [(about, -arrival) for arrival, (about, _) in self._items.items() if arrival < frame]
        if not earlier:
            return None
        arrival = -max(earlier)[1]
        return arrival, self._items[arrival][1]


class Newest(Generic[Item]):
    """Keeps the newest item of each publisher, by its time, until it is too old.

    max_age_s: the greatest age; a time that is off by more, either way, counts as too old
    """

    def __init__(self, max_age_s: float = MAX_AGE_S) -> None:
        self._max_age_ns = round(max_age_s * 1e9)
        self._items: dict[str, tuple[int, Item]] = {}

    def add(self, publisher: str, time_ns: int, item: Item) -> None:
        """Add an item; one that is older than that before is not kept."""
        if publisher not in self._items or time_ns >= self._items[publisher][0]:
            self._items[publisher] = time_ns, item

    def at(self, time_ns: int) -> dict[str, tuple[int, Item]]:
        """(age in ns, item) of each publisher at a time. Items that are too old by then are forgotten."""
        self._items = {name: each for name, each in self._items.items() if abs(time_ns - each[0]) <= self._max_age_ns}
        return {name: (time_ns - added_ns, item) for name, (added_ns, item) in self._items.items()}


class CollationBuffer(Generic[Item]):
    """Bounded per-agent min-heaps by frame; a full heap drops its *oldest* item.

    An agent has one item per frame: the first. A second one is a duplicate, even if the first has been emitted.

    capacity: items kept per agent
    """

    def __init__(self, capacity: int = 10) -> None:
        self.capacity = capacity
        self.dropped = 0
        self.late: dict[str, int] = {}
        self.duplicates = 0
        self._heaps: dict[str, list[tuple[int, Item]]] = {}
        self._recent_frames: dict[str, deque[int]] = {}  # recent frames of each agent
        self._emitted = -1
        self._newest_emitted: dict[str, int] = {}  # frame of each agent's newest item in a batch

    def push(self, agent: str, frame: int, item: Item) -> bool:
        """Add an item; returns False for a duplicate, or if a batch had a newer item of the same agent.

        An item counts as late if the batch of its frame has been emitted. A later batch has it all the same.
        """
        recent_frames = self._recent_frames.setdefault(agent, deque(maxlen=_REMEMBERED))
        heap = self._heaps.get(agent, [])
        if frame in recent_frames or any(entry[0] == frame for entry in heap):
            self.duplicates += 1
            return False
        recent_frames.append(frame)
        if frame <= self._emitted:
            self.late[agent] = self.late.get(agent, 0) + 1
            if frame <= self._newest_emitted.get(agent, -1):
                return False
        self._heaps[agent] = heap
        heapq.heappush(heap, (frame, item))  # frames are unique, so items are never compared
        if len(heap) > self.capacity:
            heapq.heappop(heap)
            self.dropped += 1
        return True

    def present(self, frame: int) -> set[str]:
        """The agents with an item for exactly this frame."""
        return {agent for agent, heap in self._heaps.items() if any(entry[0] == frame for entry in heap)}

    def complete(self, frame: int, agents: Set[str]) -> bool:
        """Whether all these agents have an item for exactly this frame."""
        return agents <= self._heaps.keys() and agents <= self.present(frame)

    def pop(self, frame: int) -> dict[str, Item]:
        """Remove and return every agent's newest item up to `frame`.

        Older items are dropped. Items for these frames that arrive afterwards count as late.
        """
        batch: dict[str, Item] = {}
        for agent in sorted(self._heaps):
            heap = self._heaps[agent]
            while heap and heap[0][0] <= frame:
                self._newest_emitted[agent], batch[agent] = heapq.heappop(heap)
            if not heap:
                del self._heaps[agent]
        self._emitted = max(self._emitted, frame)
        return batch


def plausible_rows(states: ObjectStates) -> Ints:
    """(k,) rows of the objects without a value beyond MAX_TRACK_VALUE or a size below 0."""
    columns = (states.position, states.velocity, states.size, states.covariance)
    bounded = sum([np.vdot(column, column) for column in columns]) <= MAX_TRACK_VALUE**2
    if bounded and states.size.min(initial=0.0) >= 0.0:
        return np.arange(len(states))  # the usual case: no value exceeds the norm of all
    flat = np.concatenate([column.reshape(len(states), -1) for column in columns], axis=1)
    return np.flatnonzero((np.abs(flat).max(axis=1) <= MAX_TRACK_VALUE) & (states.size >= 0.0).all(axis=1))


def plausible(states: ObjectStates, counts: MutableMapping[str, int]) -> ObjectStates:
    """The objects in `plausible_rows`; the number of others is added to `counts["absurd"]`."""
    rows = plausible_rows(states)
    counts["absurd"] += len(states) - len(rows)
    return states if len(rows) == len(states) else states.select(rows)
