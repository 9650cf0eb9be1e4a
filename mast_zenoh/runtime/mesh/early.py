"""Early messages: messages of epochs that this node has not entered yet."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

from mast_zenoh.runtime.limits import EARLY, Room


class Early(NamedTuple):
    """A message of a later epoch: key, payload, and the contents of its stamp."""

    key: str
    payload: bytes
    epoch: int
    step: int


class EarlyMessages:
    """Keeps early messages until their epoch begins, limited by source."""

    def __init__(self) -> None:
        self._kept: list[Early] = []
        self._room = Room(EARLY)
        self._dropped: Counter[str] = Counter()  # of the next epoch, by key

    def keep(self, source: str, message: Early) -> bool:
        """Keep a message; False if its source has no room left."""
        if not self._room.take(source, len(message.payload)):
            return False
        self._kept.append(message)
        return True

    def note_dropped(self, key: str, count: int = 1) -> None:
        """Count dropped messages of the next epoch: the driver will wait for them."""
        self._dropped[key] += count

    def take_dropped(self) -> Counter[str]:
        """Remove and return the number of dropped messages of the new epoch, by key."""
        dropped, self._dropped = self._dropped, Counter()
        return dropped

    def take(self) -> list[Early]:
        """Remove and return all kept messages."""
        kept, self._kept, self._room = self._kept, [], Room(EARLY)
        return kept
