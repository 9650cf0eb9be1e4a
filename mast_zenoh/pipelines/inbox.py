"""What a peer hears from other agents, until the next frame."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

from mast_zenoh.messages.schemas import Message

#: Messages of one agent that wait for the next frame, at most.
MAX_WAITING = 64


class Heard(NamedTuple):
    """A message from another agent. arrived: frame of arrival"""

    arrived: int
    port: str
    sender: str
    message: Message

    def order(self) -> tuple[Any, ...]:
        """Its place among those that wait."""
        header = self.message.header
        return self.arrived, self.sender, self.port, header.time_ns, header.frame, header.seq


class Inbox:
    """Messages that wait for the frame after that of their arrival, in an order that is not that of arrival."""

    def __init__(self) -> None:
        self._messages: list[Heard] = []
        self._waiting: Counter[str] = Counter()  # by sender

    def add(self, heard: Heard) -> bool:
        """Add a message; False if too many of its sender wait already."""
        if self._waiting[heard.sender] >= MAX_WAITING:
            return False
        self._waiting[heard.sender] += 1
        self._messages.append(heard)
        return True

    def take(self, frame: int) -> list[Heard]:
        """Take out the messages that arrived before a frame."""
        ready = sorted((heard for heard in self._messages if heard.arrived < frame), key=Heard.order)
        self._messages = [heard for heard in self._messages if heard.arrived >= frame]
        self._waiting = Counter(heard.sender for heard in self._messages)
        return ready
