"""Messages held by a host until the clock of the step in which they were sent."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from mast_zenoh.node import Received
from mast_zenoh.runtime.limits import HELD, Room
from mast_zenoh.wiring.model import Input


class Held(NamedTuple):
    """A held message; counted: whether lock-step waits for it."""

    key: str
    port_input: Input
    received: Received
    counted: bool


class HeldMessages:
    """Held messages by step, limited by source; `len` is their number."""

    def __init__(self) -> None:
        self._by_step: dict[int, list[tuple[Held, str, int]]] = {}  # with source and size
        self._room = Room(HELD)

    def __len__(self) -> int:
        return sum(map(len, self._by_step.values()))

    def hold(self, step: int, source: str, message: Held) -> bool:
        """Hold a message; False if its source has no room left."""
        size = _size(message.received)
        if not self._room.take(source, size):
            return False
        self._by_step.setdefault(step, []).append((message, source, size))
        return True

    def release(self, frame: int) -> Iterator[Held]:
        """Remove and yield messages of steps up to `frame`, by step and order of arrival."""
        for step in sorted(step for step in self._by_step if step <= frame):
            for message, source, size in self._by_step.pop(step):
                self._room.free(source, size)
                yield message


def _size(received: Received) -> int:
    """Size of a message, bytes: its payload, or its columns if it was never encoded."""
    payload = received.payload
    return len(payload) if payload is not None else sum(column.nbytes for column in received.body.values())
