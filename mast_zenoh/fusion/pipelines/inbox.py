"""What a peer hears from other agents, until the next frame."""

from __future__ import annotations

from mast_zenoh.node import Received

#: Messages on one wire in a frame that wait for the next one, at most.
MAX_WAITING = 64


class Inbox:
    """Messages that wait for the frame after that of their arrival, in an order that is not that of arrival."""

    def __init__(self) -> None:
        # By frame of arrival, then by wire, its sender and port: only messages of one wire arrive in a fixed order.
        self._waiting: dict[int, dict[tuple[str, str], list[Received]]] = {}

    def add(self, frame: int, received: Received) -> bool:
        """Add a message that arrives in a frame; False if too many on its wire have arrived in it already."""
        wire = received.subject, received.port
        waiting = self._waiting.setdefault(frame, {}).setdefault(wire, [])
        if len(waiting) < MAX_WAITING:
            waiting.append(received)
            return True
        return False

    def take(self, frame: int) -> list[Received]:
        """Take out the messages that arrived before a frame."""
        return [
            received
            for arrived in sorted(each for each in self._waiting if each < frame)
            for _, messages in sorted(self._waiting.pop(arrived).items())
            for received in sorted(messages, key=_order)
        ]


def _order(received: Received) -> tuple[int, int, int]:
    return received.time_ns, received.frame, received.message.header.seq
