"""Prepares the frames of the scene in advance, and sends each when it is due."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from mast_zenoh.node import Context, Source
from mast_zenoh.runtime.host import Outgoing
from mast_zenoh.runtime.protocol.node import MAX_FRAMES


class SceneFrames:
    """Prepares each frame while the mesh handles the previous one.

    Until it is sent, a frame is only bytes in this process: no node can act on it too early.

    send:    sends a message;  wall_ns: the wall clock
    sent:    messages of the current epoch, by key
    sent_ns: times when the newest frames were sent, ns on the wall clock
    """

    def __init__(
        self, source: Source, context: Context, send: Callable[[Outgoing], None], wall_ns: Callable[[], int]
    ) -> None:
        self.sent: Counter[str] = Counter()
        self.sent_ns: dict[int, int] = {}
        self._source = source
        self._context = context
        self._send = send
        self._wall_ns = wall_ns
        self._ready: list[Outgoing] | None = None

    def keep(self, message: Outgoing) -> None:
        """Keep what the source publishes until its frame is sent."""
        assert self._ready is not None
        self._ready.append(message)

    def prepare(self) -> None:
        """Prepare the next frame; at the end of the scene it has no messages."""
        self._ready = []
        self._source.advance(self._context)

    def send(self, number: int) -> bool:
        """Send the prepared frame as frame `number`; False if there is none."""
        if self._ready is None:
            self.prepare()
        if not self._ready:
            return False
        self.sent_ns[number] = self._wall_ns()
        self.sent_ns.pop(number - MAX_FRAMES, None)
        for message in self._ready:
            self._send(message)
            self.sent[message.key] += 1
        return True
