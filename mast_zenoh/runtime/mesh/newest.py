"""The newest value of each node, announced in the inbox once until it is taken: so no flood fills a queue."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from mast_zenoh.runtime.mesh.inbox import Event

T = TypeVar("T")


class NewestByNode(Generic[T]):
    """Zenoh's threads note values, the main thread takes them when it gets the event (kind, node).

    put:   adds an event to the inbox
    merge: the value that waits and a newer one to the one that waits from now on
    rest:  of a value that is taken, what is left to be taken in a further event; None: nothing
    """

    def __init__(
        self,
        kind: str,
        put: Callable[[Event], None],
        merge: Callable[[T, T], T] = lambda waiting, newer: newer,
        rest: Callable[[T], T | None] = lambda taken: None,
    ) -> None:
        self._kind = kind
        self._put = put
        self._merge = merge
        self._rest = rest
        self._waiting: dict[str, T] = {}
        self._lock = threading.Lock()

    def note(self, node: str, value: T) -> None:
        """A newer value of a node has come."""
        with self._lock:
            announced = node in self._waiting
            self._waiting[node] = self._merge(self._waiting[node], value) if announced else value
        if not announced:
            self._put((self._kind, node))

    def take(self, node: str) -> T:
        """The value of a node that an event has announced."""
        with self._lock:
            taken = self._waiting.pop(node)
            rest = self._rest(taken)
            if rest is not None:
                self._waiting[node] = rest
        if rest is not None:
            self._put((self._kind, node))
        return taken
