"""A node's link to programs outside the run: opens its session, keeps what arrives, and waits for answers.

Threads of the session put what arrives into queues of limited length and size; the node's thread takes it out. In a
full queue, the publisher with most messages loses its oldest one: a flood does not displace the others.

Signal handlers and other threads end a wait by setting `ended`, which is looked at every 50 ms.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mast_zenoh.outside import Arrival, OutsideTopic, OutsideTopics

#: s, after which a wait looks whether it has become useless.
_LOOK_S = 0.05
#: s, for which a message proves that a publisher is there of which the session does not know.
_PRESENT_S = 5.0
#: Frames whose clocks' times of arrival are kept.
_CLOCKS_KEPT = 64


class OutsideLink:
    """The link of one node, open until `close`.

    name: of the node
    waits: whether the run waits for answers
    notify: called in another thread when something has arrived, and the node has taken all that came before
    stopping: whether the run is being stopped

    Raises NotRunning if the session cannot be opened, with the reason.
    """

    def __init__(
        self,
        name: str,
        topics: OutsideTopics,
        *,
        waits: bool,
        notify: Callable[[], None] = lambda: None,
        stopping: Callable[[], bool] = lambda: False,
    ) -> None:
        self.waits = waits
        self.clock_arrivals_ns: dict[int, int] = {}
        self._ended = False
        self._notify = notify
        self._stopping = stopping
        self._overflows: Counter[str] = Counter()
        self._changed = threading.Event()
        self._lock = threading.Lock()
        self._waiting = {topic.name: deque[Arrival]() for topic in topics.received}
        self._unannounced: dict[str, float] = {}  # when a message came without a known publisher, by topic
        self._session = topics.join(name)
        self.announce, self.send = self._session.announce, self._session.send
        self.heard, self.absence, self.close = self._session.heard, self._session.absence, self._session.close
        try:
            for topic in topics.received:
                self._session.receive(topic, self._keep(topic))
        except BaseException:
            self.close()
            raise

    @property
    def ended(self) -> bool:
        """Whether the run is being stopped."""
        return self._ended or self._stopping()

    def end(self) -> None:
        """Wait for nothing any more; from any thread, or a signal handler."""
        self._ended = True

    @property
    def refused(self) -> Mapping[str, int]:
        """Number of messages that were dropped before the node got them, by reason."""
        return Counter(self._session.refused) + Counter(self._overflows)  # copies: other threads count on

    def take(self) -> list[Arrival]:
        self._changed.clear()
        arrivals: list[Arrival] = []
        with self._lock:
            for waiting in self._waiting.values():
                arrivals += waiting
                waiting.clear()
        return arrivals

    def wait(self, limit_s: float, done: Callable[[], bool], needed: Sequence[str] = ()) -> bool:
        deadline = time.monotonic() + limit_s
        while True:
            left_s = deadline - time.monotonic()  # before `done`, which may take long: what came in time counts
            self._changed.clear()
            if done():
                return True
            if left_s <= 0.0 or self.ended or not all(map(self.present, needed)):
                return False
            self._changed.wait(min(left_s, _LOOK_S))

    def present(self, topic: str) -> bool:
        is_recent = time.monotonic() - self._unannounced.get(topic, -math.inf) < _PRESENT_S
        return is_recent or self._session.is_published(topic)

    def note_clock(self, frame: int) -> None:
        """Note that the clock of a frame has arrived now."""
        self.clock_arrivals_ns[frame] = time.time_ns()
        if len(self.clock_arrivals_ns) > _CLOCKS_KEPT:
            del self.clock_arrivals_ns[min(self.clock_arrivals_ns)]

    def _keep(self, topic: OutsideTopic) -> Callable[[Any, bytes], None]:
        """A function that keeps a message of a topic for the node."""
        waiting = self._waiting[topic.name]

        def keep(message: Any, publisher: bytes) -> None:
            if not self._session.is_published(topic.name):
                self._unannounced[topic.name] = time.monotonic()
            with self._lock:
                waiting.append(Arrival(topic.name, message, publisher))
                if len(waiting) > topic.depth:
                    publishers = [arrival.publisher for arrival in waiting]
                    ((most, _),) = Counter(publishers).most_common(1)
                    del waiting[publishers.index(most)]
                    self._overflows["overtaken"] += 1  # by newer ones of its topic
            if not self._changed.is_set():
                self._changed.set()
                self._notify()

        return keep
