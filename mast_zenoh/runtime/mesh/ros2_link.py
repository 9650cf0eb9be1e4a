"""A node's link to nodes of ROS 2: opens a participant for it, keeps what arrives, and waits for answers.

Zenoh's threads put what arrives into queues of limited length and size; the node's thread takes it out. In a full
queue, the publisher with most messages loses its oldest one: a flood does not displace the others.

Signal handlers and other threads end a wait by setting `ended`, which is looked at every 50 ms.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mast_zenoh.ros2.attachments import Attachment, gid_of
from mast_zenoh.ros2.outside import Arrival, OutsideTopic, OutsideTopics, ros2_name
from mast_zenoh.ros2.qos import TRANSIENT_LOCAL, Qos
from mast_zenoh.runtime.mesh.ros2_participant import MAST_PREFIX, Participant, Publisher

#: s, after which a wait looks whether it has become useless.
_LOOK_S = 0.05
#: s, for which a message proves that a publisher is there that has no known token.
_PRESENT_S = 5.0
#: Frames whose clocks' times of arrival are kept.
_CLOCKS_KEPT = 64


class Ros2Link:
    """The link of one node, open until `close`.

    name: of the node; that of its ROS 2 node is mast_NAME
    waits: whether the run waits for answers
    notify: called in another thread when something has arrived, and the node has taken all that came before
    stopping: whether the run is being stopped

    Raises NotRunning if no router answers, with the reason.
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
        self._publishers: dict[str, Publisher] = {}
        self._own_gids: set[bytes] = set()
        self._changed = threading.Event()
        self._lock = threading.Lock()
        self._waiting = {topic.name: deque[Arrival]() for topic in topics.received}
        self._unannounced: dict[str, float] = {}  # when a message came without a known publisher, by topic
        # A peer that takes nothing must not stop the run: its messages are dropped.
        self._participant = Participant(topics.connection, ros2_name(MAST_PREFIX + name), wait=False)
        try:
            for topic in topics.received:
                self._subscribe(topic)
        except BaseException:
            self._participant.close()
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
        return Counter(self._participant.refused) + Counter(self._overflows)  # copies: other threads count on

    def announce(self, topic: str, type_name: str) -> None:
        if topic not in self._publishers:
            self._publishers[topic] = publisher = self._participant.publisher(topic, type_name)
            self._own_gids.add(gid_of(publisher.token.write()))

    def send(self, topic: str, message: Any) -> None:
        self._publishers[topic].publish(message)

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
        return is_recent or self._participant.is_published(topic)

    def heard(self, topic: str) -> bool:
        return self._publishers[topic].is_wanted

    def absence(self, topic: str) -> str:
        return self._participant.absence(topic)

    def note_clock(self, frame: int) -> None:
        """Note that the clock of a frame has arrived now."""
        self.clock_arrivals_ns[frame] = time.time_ns()
        if len(self.clock_arrivals_ns) > _CLOCKS_KEPT:
            del self.clock_arrivals_ns[min(self.clock_arrivals_ns)]

    def close(self) -> None:
        """Leave the mesh of ROS 2."""
        self._participant.close()

    def _subscribe(self, topic: OutsideTopic) -> None:
        waiting = self._waiting[topic.name]

        def keep(message: Any, attachment: Attachment) -> None:
            if attachment.gid in self._own_gids:  # of this node, as on /tf
                return
            if not self._participant.is_published(topic.name):
                self._unannounced[topic.name] = time.monotonic()
            with self._lock:
                waiting.append(Arrival(topic.name, message, attachment.gid))
                if len(waiting) > topic.depth:
                    gids = [arrival.gid for arrival in waiting]
                    ((most, _),) = Counter(gids).most_common(1)
                    del waiting[gids.index(most)]
                    self._overflows["overtaken"] += 1  # by newer ones of its topic
            if not self._changed.is_set():
                self._changed.set()
                self._notify()

        qos = Qos(durability=TRANSIENT_LOCAL, depth=topic.depth) if topic.transient_local else Qos(depth=topic.depth)
        self._participant.subscribe(topic.name, topic.type_name, keep, qos, most_bytes=topic.most_bytes)
