"""What a peer hears from other agents, until the next frame."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

from mast_zenoh.messages.schemas import Message

#: Messages on one wire in a frame that wait for the next one, at most.
MAX_WAITING = 64


class Heard(NamedTuple):
    """A message from another agent. arrived: frame of arrival"""

    arrived: int
    port: str
    sender: str
    message: Message

    @property
    def wire(self) -> tuple[str, str, int]:
        """Its sender, port and frame of arrival."""
        return self.sender, self.port, self.arrived

    def order(self) -> tuple[Any, ...]:
        """Its place among those that wait."""
        header = self.message.header
        return self.arrived, self.sender, self.port, header.time_ns, header.frame, header.seq


class Inbox:
    """Messages that wait for the frame after that of their arrival, in an order that is not that of arrival."""

    def __init__(self) -> None:
        self._messages: list[Heard] = []
        # By wire and frame: only messages of one wire arrive in a fixed order.
        self._waiting: Counter[tuple[str, str, int]] = Counter()

    def add(self, heard: Heard) -> bool:
        """Add a message; False if too many on its wire arrived in the frame already."""
        if self._waiting[heard.wire] >= MAX_WAITING:
            return False
        self._waiting[heard.wire] += 1
        self._messages.append(heard)
        return True

    def take(self, frame: int) -> list[Heard]:
        """Take out the messages that arrived before a frame."""
        ready = sorted((heard for heard in self._messages if heard.arrived < frame), key=Heard.order)
        self._messages = [heard for heard in self._messages if heard.arrived >= frame]
        self._waiting = Counter(heard.wire for heard in self._messages)
        return ready
