"""Arrival times of the messages of each frame, for measuring latency."""

from __future__ import annotations

import time

from mast_zenoh.messages.schemas import Header

MAX_FRAMES = 4096  #: number of frames, by key, whose times are kept: the newest


class Arrivals:
    """Arrival times of the newest frames, so that memory is bounded.

    by_key: time of the first message of each frame by key, ns on the wall clock
    """

    def __init__(self) -> None:
        self.by_key: dict[str, dict[int, int]] = {}

    def note(self, key: str, header: Header) -> None:
        """Note the arrival of a valid message."""
        arrived_ns = self.by_key.setdefault(key, {})
        arrived_ns.setdefault(header.frame, time.time_ns())
        if len(arrived_ns) > MAX_FRAMES:
            del arrived_ns[next(iter(arrived_ns))]
