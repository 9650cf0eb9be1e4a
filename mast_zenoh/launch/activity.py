"""What the nodes of a run send, measured on the mesh while it plays.

Nothing here is a node's own account: messages that arrive are counted, and the steps in their stamps are read. Zenoh
keeps the newest messages of a key without running Python, so a watched message costs the launcher a microsecond or two.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh

from mast_zenoh.runtime.protocol.stamp import stamp_of
from mast_zenoh.wiring.model import TAP, Wiring

_CAPACITY = 32  # messages of a key between two calls of `read`; with more, missing ones are not counted
_WINDOW_S = 2.0  # over which rates are measured
_SHORTEST_S = 0.2  # for a rate

#: Message types that a node sends in every frame, even if there is nothing in them.
_EVERY_FRAME = ("clock", "truth", "tracks", "collated", "picture")


class Activity(NamedTuple):
    """What one node has sent lately; None: not known.

    rate_hz: frames per second in which it has sent something
    lag:     frames by which its newest message is behind the scene
    drops:   frames without a message, between the first and the newest one
    """

    rate_hz: float | None = None
    lag: int | None = None
    drops: int | None = None


class Activities:
    """Watches one key of each node, through the router's own session: its messages cross no link for that.

    frame: returns the newest frame of the run
    Hidden legs are not watched: their publishers wait until the node behind them has subscribed.
    """

    def __init__(self, session: zenoh.Session, prefix: str, wiring: Wiring, frame: Callable[[], int]) -> None:
        self._frame = frame
        self._keys = {
            node: _Key(session, f"{prefix}/{key}", counted=counted)
            for node, (key, counted) in watched_keys(wiring).items()
        }

    def read(self) -> None:
        """Take what has arrived; to be called often, such as 20 times a second."""
        for key in self._keys.values():
            key.read(self._frame)

    def of(self, node: str) -> Activity:
        """What a node has sent, as of the last `read`."""
        key = self._keys.get(node)
        return Activity() if key is None else key.activity(self._frame())

    def close(self) -> None:
        """End the subscriptions."""
        for key in self._keys.values():
            key.subscriber.undeclare()
        self._keys = {}


def watched_keys(wiring: Wiring) -> dict[str, tuple[str, bool]]:
    """By node, the key on which it is heard, and whether it sends something there in every frame.

    A leg before an interposer only where the node sends nothing else in every frame.
    """
    ranked: dict[str, tuple[tuple[bool, bool], str]] = {}
    for wire, leg in wiring.legs():
        node, rank = leg.publisher.node, (wire.message in _EVERY_FRAME, TAP not in leg.key.split("/"))
        if node not in ranked or rank > ranked[node][0]:
            ranked[node] = rank, leg.key
    return {node: (key, counted) for node, ((counted, _), key) in ranked.items()}


class _Key:
    """The messages of one key: the newest step, and the number of frames with and without a message."""

    def __init__(self, session: zenoh.Session, key: str, *, counted: bool) -> None:
        self.subscriber: Any = session.declare_subscriber(key, zenoh.handlers.RingChannel(_CAPACITY))
        self._counted = counted
        self._newest = -1
        self._frames = 0
        self._drops = 0
        self._history: deque[tuple[float, int]] = deque()  # times of `read`, s, and frames up to then

    def read(self, frame: Callable[[], int]) -> None:
        """Take what has arrived."""
        steps: list[int] = []
        while (sample := self.subscriber.try_recv()) is not None:
            steps.append(stamp_of(sample.attachment)[1])
        # A step beyond the scene is forged. Its clock may arrive here a moment after the message.
        newest = max((step for step in steps if step <= frame() + 1), default=-1)
        if newest > self._newest:
            passed = newest - self._newest if self._newest >= 0 else 1
            seen = passed if len(steps) >= _CAPACITY else len({step for step in steps if self._newest < step <= newest})
            self._frames += seen
            self._drops += max(0, passed - seen)
            self._newest = newest
        now = time.monotonic()
        self._history.append((now, self._frames))
        while now - self._history[0][0] > _WINDOW_S:
            self._history.popleft()

    def activity(self, frame: int) -> Activity:
        """What has arrived up to the last `read`; frame: the newest of the run."""
        if self._newest < 0:
            return Activity()
        (begun, before), (now, frames) = self._history[0], self._history[-1]
        rate_hz = (frames - before) / (now - begun) if now - begun >= _SHORTEST_S else None
        return Activity(rate_hz, max(0, frame - self._newest), self._drops if self._counted else None)
