"""Programs outside a run that take part in it: what its nodes exchange with them, and how the run counts it.

Whoever brings such programs in gives two things: a session with them (`OutsideSession`), and a node that names it in
`Node.outside_topics`. The runtime opens the session, queues what arrives, and ends what waits
(`mast_zenoh.mesh.outside_link`); the node gets an `Outside` as `Context.outside`, counts with an `OutsideTally`,
and returns its results as `outside` from `finish`. Then the run says that its results depend on these programs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from mast_zenoh.errors import MessageError

#: Publishers of a topic that are told apart.
MOST_PUBLISHERS = 16
#: Reasons that are told apart.
_MOST_REASONS = 50


class OutsideTopic(NamedTuple):
    """A topic on which a node receives messages from outside the run.

    type_name: of its messages, in the words of the session
    retained: whether what was sent earlier arrives, too
    depth: messages that wait for the node, at most: the newest;  most_bytes: of one of them
    """

    name: str
    type_name: str = ""
    retained: bool = False
    depth: int = 8
    most_bytes: int = 1 << 21


class OutsideTopics(NamedTuple):
    """What a node receives from outside the run.

    join: opens the session of the node with this name; raises NotRunning with the reason if it cannot
    """

    join: Callable[[str], OutsideSession]
    received: tuple[OutsideTopic, ...]


class Arrival(NamedTuple):
    """A message from outside: a valid one of its topic's type, with values of any kind. publisher: its id"""

    topic: str
    message: Any
    publisher: bytes = b""


class _Sending(Protocol):
    def announce(self, topic: str, type_name: str) -> None:
        """Make a topic known on which the node sends messages of this type."""

    def send(self, topic: str, message: Any) -> None:
        """Send a message on an announced topic; dropped if its receivers take nothing for 1 s."""

    def heard(self, topic: str) -> bool:
        """Whether a program outside subscribes to an announced topic."""

    def absence(self, topic: str) -> str:
        """Why nothing can arrive on a topic now, as a clause; "": a program outside publishes on it."""

    @property
    def refused(self) -> Mapping[str, int]:
        """Number of messages that were dropped before the node got them, by reason."""


class OutsideSession(_Sending, Protocol):
    """A node's session with programs outside the run; what these send is untrusted."""

    def receive(self, topic: OutsideTopic, keep: Callable[[Any, bytes], None]) -> None:
        """Have a function called with each message of a topic and the id of its publisher, in any thread.

        Not with what cannot be read, and not with what the node itself has sent.
        """

    def is_published(self, topic: str) -> bool:
        """Whether a program outside says that it publishes on a topic."""

    def close(self) -> None:
        """End the session."""


class Outside(_Sending, Protocol):
    """A node's link to programs outside the run.

    waits: whether the run waits for answers, as in lock-step
    ended: whether the run is being stopped, so that nothing is waited for any more
    clock_arrivals_ns: wall-clock times at which the clocks of the newest frames arrived, ns, by frame
    """

    waits: bool

    @property
    def ended(self) -> bool: ...

    @property
    def clock_arrivals_ns(self) -> Mapping[int, int]: ...

    def take(self) -> list[Arrival]:
        """What has arrived since the last call: topic by topic, each in order."""

    def wait(self, limit_s: float, done: Callable[[], bool], needed: Sequence[str] = ()) -> bool:
        """Wait until `done()`, which is called after each arrival; False after `limit_s`, s, or if the run ends.

        needed: topics without whose publishers waiting is useless: False as soon as one has none
        """

    def present(self, topic: str) -> bool:
        """Whether a program outside publishes on a topic: it says so, or a message has come lately."""


class _Silence(NamedTuple):
    """Why nothing arrived on a topic: from a frame on, until the first frame that was answered again."""

    since: int
    reason: str
    until: int | None = None

    def __str__(self) -> str:
        end = "on" if self.until is None else f"to {self.until}"
        return f"from frame {self.since} {end}: {self.reason}"


class OutsideTally:
    """What a node counts of its exchange with programs outside the run.

    topics: on which answers come

    counts: messages `asked`, `answered`, answered `late`, and `interrupted` by the end of the run
    refused: number of received messages that are of no use, by reason
    left_out: number of objects and the like that are not used of used messages, by reason
    unclassified: number of used objects with a class that is not ours
    """

    def __init__(self, topics: Iterable[str]) -> None:
        self.counts = dict.fromkeys(("asked", "answered", "late", "interrupted"), 0)
        self.refused: Counter[str] = Counter()
        self.left_out: Counter[str] = Counter()
        self.unclassified = 0
        self._publishers: dict[str, set[bytes]] = {topic: set() for topic in topics}
        self._absent: dict[str, _Silence] = {}  # the newest, by topic

    def note_publisher(self, arrival: Arrival) -> None:
        """Count the publishers of a topic of answers."""
        if len(self._publishers[arrival.topic]) < MOST_PUBLISHERS:
            self._publishers[arrival.topic].add(arrival.publisher)

    def note_answer(self, topic: str, frame: int, *, late: bool = False) -> None:
        """Count an answer about a frame."""
        self.counts["late" if late else "answered"] += 1
        if (absent := self._absent.get(topic)) is not None and absent.until is None:
            self._absent[topic] = absent._replace(until=frame)

    def note_missing(self, outside: Outside, topics: Collection[str], frame: int) -> None:
        """Note that answers about a frame did not come, and why nothing can arrive on their topics from it on."""
        if outside.ended:  # nobody has failed to answer
            self.counts["asked"] -= len(topics)
            self.counts["interrupted"] += len(topics)
        else:
            self.note_absent(outside, topics, frame)

    def note_absent(self, outside: Outside, topics: Collection[str], frame: int) -> None:
        """Note why nothing can arrive on topics from a frame on, until an answer comes."""
        for topic in topics:
            known = self._absent.get(topic)
            if (known is None or known.until is not None) and (reason := outside.absence(topic)):
                self._absent[topic] = _Silence(frame, reason)

    def refuse(self, error: MessageError) -> None:
        """Count a message that cannot be used, by the reason's part before the colon."""
        _count(self.refused, str(error).partition(":")[0], 1)

    def leave_out(self, reason: str, number: int) -> None:
        """Count objects or the like that are left out, by reason."""
        if number:
            _count(self.left_out, reason, number)

    def results(self, outside: Outside) -> dict[str, Any]:
        """The counts, for the results of a node."""
        unanswered = self.counts["asked"] - self.counts["answered"] - self.counts["late"]
        return {
            **self.counts,
            "waits": outside.waits,
            "unanswered": max(0, unanswered),  # an answer may come after the end of the run was announced
            "unclassified": self.unclassified,
            "publishers": {topic: len(ids) for topic, ids in self._publishers.items() if ids},
            "refused": dict(self.refused + Counter(outside.refused)),
            "left_out": dict(self.left_out),
            "absent": {topic: str(absence) for topic, absence in self._absent.items()},
        }


def _count(counts: Counter[str], reason: str, number: int) -> None:
    """Count a reason; programs outside choose the words of some, so that only the first ones are told apart."""
    reason = " ".join(reason.split())[:120]
    counts[reason if reason in counts or len(counts) < _MOST_REASONS else "other reasons"] += number
