"""When the messages of each frame came, for measuring latency."""

from __future__ import annotations

import time

from mast_zenoh.messages.schemas import Header

NOTED_FRAMES = 4096  #: the newest frames of which times are kept, by key


class Arrivals:
    """by_key: by key and frame when the first message came, ns on the wall clock.

    Of the newest frames only, so that no run is long enough to fill the memory.
    """

    def __init__(self) -> None:
        self.by_key: dict[str, dict[int, int]] = {}

    def note(self, key: str, header: Header) -> None:
        """A sound message has come."""
        came = self.by_key.setdefault(key, {})
        came.setdefault(header.frame, time.time_ns())
        if len(came) > NOTED_FRAMES:
            del came[next(iter(came))]
