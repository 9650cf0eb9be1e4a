"""A link to programs outside the run that are functions: for tests of nodes with `outside_topics`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from mast_zenoh.outside import Arrival

#: What a program outside answers to a message: (topic, message) of each answer, in order.
Program = Callable[[str, Any], Iterable[tuple[str, Any]]]


class FakeLink:
    """A link to one program, which answers at once, and is always there.

    program: called with the topic and the content of each message that the node sends
    waits: whether the run waits for answers, as in lock-step
    sent: the messages of the node, as (topic, message);  announced: their types by topic
    waited_s: the limits of the waits that were in vain, s
    clock_arrivals_ns, refused: see `Outside`
    """

    def __init__(self, program: Program = lambda topic, message: (), *, waits: bool = True) -> None:
        self.waits = waits
        self.ended = False
        self.announced: dict[str, str] = {}
        self.sent: list[tuple[str, Any]] = []
        self.waited_s: list[float] = []
        self.clock_arrivals_ns: dict[int, int] = {}
        self.refused: Mapping[str, int] = Counter()
        self.program = program
        self._arrivals: list[Arrival] = []

    def announce(self, topic: str, type_name: str) -> None:
        self.announced[topic] = type_name

    def send(self, topic: str, message: Any) -> None:
        assert topic in self.announced, f"{topic}: not announced"
        self.sent.append((topic, message))
        for answer in self.program(topic, message):
            self.arrive(*answer)

    def arrive(self, topic: str, message: Any, publisher: bytes = bytes(16)) -> None:
        """Let a message from outside arrive. publisher: its id"""
        self._arrivals.append(Arrival(topic, message, publisher))

    def take(self) -> list[Arrival]:
        arrivals, self._arrivals = self._arrivals, []
        return arrivals

    def wait(self, limit_s: float, done: Callable[[], bool], needed: Sequence[str] = ()) -> bool:
        if done():
            return True
        self.waited_s.append(limit_s)
        return False

    def present(self, topic: str) -> bool:
        return True

    def heard(self, topic: str) -> bool:
        return True

    def absence(self, topic: str) -> str:
        return ""

    def note_clock(self, frame: int) -> None:
        self.clock_arrivals_ns.setdefault(frame, frame)

    def end(self) -> None:
        self.ended = True

    def close(self) -> None:
        pass
