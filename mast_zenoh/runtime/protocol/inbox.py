"""What a process has received and not yet handled; limited, so that no sender can fill its memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from mast_zenoh.runtime.limits import INBOX, Limit, Room

Event = tuple[Any, ...]

#: An event in the queue, with the source and the size of a message of a wire; size -1: of another event.
Item = tuple[Event, str, int]


class Inbox:
    """Puts events into a queue.

    Messages of wires are events ("message", key, payload, epoch, step), limited by source. The event ("dropped",)
    announces that messages were dropped; `take_dropped` returns their number. Events of kinds of which only the newest
    counts are (kind, node); `take_newest` returns the value.

    put:  adds an item to the queue, from any thread
    lock: of what is counted here
    """

    def __init__(
        self, put: Callable[[Item], object], lock: AbstractContextManager[object], limit: Limit = INBOX
    ) -> None:
        self.room = Room(limit)
        self._put = put
        self._lock = lock
        self._dropped: Counter[tuple[str, int]] = Counter()
        self._newest: dict[tuple[str, str], Any] = {}

    def put(self, event: Event) -> None:
        """Add an event that is not a message of a wire."""
        self._put((event, "", -1))

    def put_message(self, source: str, event: Event, epoch: int) -> bool:
        """Add the event of a message; False if it is dropped: its source has no room left.

        epoch: in which it counts for lock-step
        """
        size = len(event[2])
        with self._lock:
            if self.room.take(source, size):
                self._put((event, source, size))
                return True
            announced = bool(self._dropped)
            self._dropped[event[1], epoch] += 1
        if not announced:
            self.put(("dropped",))
        return False

    def put_newest(
        self, kind: str, node: str, value: Any, merge: Callable[[Any, Any], Any] = lambda waiting, newer: newer
    ) -> None:
        """Add a value of a node; merge: combines one that waits with a newer one."""
        with self._lock:
            announced = (kind, node) in self._newest
            self._newest[kind, node] = merge(self._newest[kind, node], value) if announced else value
        if not announced:
            self.put((kind, node))

    def take(self, item: Item) -> Event:
        """The event of an item from the queue."""
        event, source, size = item
        if size >= 0:
            with self._lock:
                self.room.free(source, size)
        return event

    def take_dropped(self) -> Counter[tuple[str, int]]:
        """Number of messages dropped since the last call, by key and epoch."""
        with self._lock:
            dropped, self._dropped = self._dropped, Counter()
        return dropped

    def take_newest(self, kind: str, node: str) -> Any:
        """The value that an event has announced."""
        with self._lock:
            return self._newest.pop((kind, node))
