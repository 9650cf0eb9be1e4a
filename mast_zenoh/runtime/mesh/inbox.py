"""Events for the main thread of a node's process, including samples of wires."""

from __future__ import annotations

import queue
import threading
from collections import Counter
from typing import Any

from mast_zenoh.runtime.limits import INBOX, Limit, Room

Event = tuple[Any, ...]


class Inbox:
    """A queue of events from Zenoh's threads to the main thread.

    Samples of wires are events ("sample", key, payload, epoch, step), limited by source. The event ("dropped",)
    announces that samples were dropped; `take_dropped` returns their number.
    """

    def __init__(self, limit: Limit = INBOX) -> None:
        self.room = Room(limit)
        self._queue: queue.SimpleQueue[tuple[Event, str, int]] = queue.SimpleQueue()
        self._lock = threading.Lock()  # of `room` and `_dropped`
        self._dropped: Counter[tuple[str, int]] = Counter()

    def put(self, event: Event) -> None:
        """Add an event that is not a sample."""
        self._queue.put((event, "", -1))

    def put_sample(self, source: str, event: Event, epoch: int) -> bool:
        """Add the event of a sample; False if it is dropped: its source has no room left.

        epoch: in which it counts for lock-step
        """
        size = len(event[2])
        with self._lock:
            if self.room.take(source, size):
                self._queue.put((event, source, size))
                return True
            announced = bool(self._dropped)
            self._dropped[event[1], epoch] += 1
        if not announced:
            self.put(("dropped",))
        return False

    def take_dropped(self) -> Counter[tuple[str, int]]:
        """Number of samples dropped since the last call, by key and epoch."""
        with self._lock:
            dropped, self._dropped = self._dropped, Counter()
        return dropped

    def get(self, timeout: float | None = None) -> Event:
        """The next event; raises queue.Empty if there is none within `timeout`, s."""
        return self._taken(*self._queue.get(timeout=timeout))

    def get_nowait(self) -> Event:
        """The next event; raises queue.Empty if there is none."""
        return self._taken(*self._queue.get_nowait())

    def _taken(self, event: Event, source: str, size: int) -> Event:
        if size >= 0:
            with self._lock:
                self.room.free(source, size)
        return event
