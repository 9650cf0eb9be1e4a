"""The newest value of each node, announced by one event at a time.

A flood of values cannot fill the inbox: a newer value replaces one that has not been taken yet.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from mast_zenoh.runtime.mesh.inbox import Event

T = TypeVar("T")


class NewestByNode(Generic[T]):
    """Zenoh's threads note values; the main thread takes them on events (kind, node).

    put:   adds an event to the inbox
    merge: combines the waiting value with a newer one
    remaining: what remains of a taken value, for another event; None: nothing
    """

    def __init__(
        self,
        kind: str,
        put: Callable[[Event], None],
        merge: Callable[[T, T], T] = lambda waiting, newer: newer,
        remaining: Callable[[T], T | None] = lambda taken: None,
    ) -> None:
        self._kind = kind
        self._put = put
        self._merge = merge
        self._remaining = remaining
        self._waiting: dict[str, T] = {}
        self._lock = threading.Lock()

    def note(self, node: str, value: T) -> None:
        """Note a newer value of a node."""
        with self._lock:
            announced = node in self._waiting
            self._waiting[node] = self._merge(self._waiting[node], value) if announced else value
        if not announced:
            self._put((self._kind, node))

    def take(self, node: str) -> T:
        """Take the value of a node that an event has announced."""
        with self._lock:
            taken = self._waiting.pop(node)
            remaining = self._remaining(taken)
            if remaining is not None:
                self._waiting[node] = remaining
        if remaining is not None:
            self._put((self._kind, node))
        return taken
