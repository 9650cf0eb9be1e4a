"""Messages that wait in a host for the clock of the step they were sent in."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from mast_zenoh.node import Received
from mast_zenoh.runtime.limits import HELD, Room
from mast_zenoh.wiring.model import Input


class Held(NamedTuple):
    """A message that waits; counted: whether lock-step waits for it."""

    key: str
    hears: Input
    received: Received
    counted: bool


class HeldMessages:
    """Keeps messages by step, as many as there is room for by source; `len` is how many wait."""

    def __init__(self) -> None:
        self._by_step: dict[int, list[tuple[Held, str, int]]] = {}  # with source and size
        self._room = Room(HELD)

    def __len__(self) -> int:
        return sum(map(len, self._by_step.values()))

    def hold(self, step: int, source: str, message: Held) -> bool:
        """Keep a message; False if its source has no room left."""
        size = _size(message.received)
        if not self._room.take(source, size):
            return False
        self._by_step.setdefault(step, []).append((message, source, size))
        return True

    def release(self, frame: int) -> Iterator[Held]:
        """The messages whose step has begun with this frame, by step and in the order in which they came."""
        for step in sorted(step for step in self._by_step if step <= frame):
            for message, source, size in self._by_step.pop(step):
                self._room.free(source, size)
                yield message


def _size(received: Received) -> int:
    """Bytes that a message takes up; where it was never bytes, its columns."""
    payload = received.payload
    return len(payload) if payload is not None else sum(column.nbytes for column in received.body.values())
