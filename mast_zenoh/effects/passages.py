"""One interposer on one wire: what it sent on, compared message by message with what it received."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from mast_zenoh.effects import objects
from mast_zenoh.effects.objects import ObjectChanges, Passed
from mast_zenoh.errors import MessageError
from mast_zenoh.node import Overheard
from mast_zenoh.wiring import Passage

#: What can happen to a whole message.
DELAYED, DROPPED, REPEATED, CORRUPTED, RESTAMPED, REFRAMED, FORGED, UNSETTLED = MESSAGE_EFFECTS = (
    "delayed",
    "dropped",
    "repeated",
    "corrupted",
    "restamped",
    "reframed",
    "forged",
    "unsettled",
)

#: Messages of one passage that wait for their counterpart; beyond these the oldest is judged without it.
MOST_WAITING = 4096
#: Messages of which it is remembered that they were sent on, so that they are recognised when they come again.
REMEMBERED = 4096
#: Changed messages that are compared at once.
BATCH = 64
#: Frames by which nodes may differ in real time about when a live change of the wiring took place.
CHANGE_FRAMES = 2
#: Part of the bytes of two messages that must be equal for one to be taken for a damaged copy of the other.
SIMILAR = 0.9

#: What identifies a message among those of its wire's publisher: frame and sequence number.
Id = tuple[int, int]


class MessageEffect(NamedTuple):
    """What an interposer did to one message.

    effect:  one of MESSAGE_EFFECTS
    frame, seq: of the message; -1 where nobody can read them
    step:    frame in which the interposer received it (forged: sent it)
    frames_late: by how many frames it was sent on later than it was received
    time_ns: ns, by how much the time in its header was changed
    columns: names of the columns, not of single objects, that were changed
    """

    effect: str
    frame: int
    seq: int
    step: int
    frames_late: int = 0
    time_ns: int = 0
    columns: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Interval:
    """The frames in which a passage is part of the wiring: from `begin`, before `end` (None: to the end of the run)."""

    begin: int
    end: int | None = None

    def has(self, step: int) -> bool:
        """Whether a message that was sent in a step took this way."""
        return self.begin <= step and (self.end is None or step < self.end)

    def near_change(self, step: int) -> bool:
        """Whether the passage came or went, while the run went on, about when a message was sent."""
        return (self.begin > 0 and step < self.begin + CHANGE_FRAMES) or (
            self.end is not None and step >= self.end - CHANGE_FRAMES
        )


class PassageMeter:
    """Compares what one interposer sends on a wire with what it receives there, in whatever order both are heard.

    effects: on messages; objects: on the objects in them; received: how many messages came in
    """

    def __init__(self, passage: Passage, interval: Interval) -> None:
        self.passage = passage
        self.interval = interval
        self.effects: list[MessageEffect] = []
        self.objects: list[ObjectChanges] = []
        self.received = 0
        self._waiting: dict[Id, list[Overheard]] = {}  # received, and not sent on yet
        self._early: dict[Id, list[Overheard]] = {}  # sent, and not known to have been received
        self._sent: dict[Id, int] = {}  # received and sent on: the frame in which it was received
        self._unreadable: tuple[list[Overheard], list[Overheard]] = [], []  # received and sent
        self._passed: list[Passed] = []  # sent on changed, and not compared yet
        self._most_late = 0

    def take_received(self, message: Overheard) -> None:
        """The interposer has received a message."""
        self.received += 1
        try:
            header = message.header
        except MessageError:
            self._unreadable[0].append(message)
            return
        id_ = header.frame, header.seq
        if id_ in self._early:
            self._pair(id_, message, _first(self._early, id_))
            return
        self._waiting.setdefault(id_, []).append(message)
        if len(self._waiting) > MOST_WAITING:
            for oldest in self._waiting.pop(next(iter(self._waiting))):
                self._withheld(DROPPED, oldest)

    def take_sent(self, message: Overheard) -> None:
        """The interposer has sent a message."""
        try:
            header = message.header
        except MessageError:
            self._unreadable[1].append(message)
            return
        id_ = header.frame, header.seq
        if id_ in self._waiting:
            self._pair(id_, _first(self._waiting, id_), message)
            return
        self._early.setdefault(id_, []).append(message)
        if len(self._early) > MOST_WAITING:
            oldest = next(iter(self._early))
            self._surplus(oldest, self._early.pop(oldest))

    def close(self, last_step: int) -> None:
        """The run is over, its last frame was `last_step`: judge what has found no counterpart."""
        self._settle()
        self._pair_unreadable()
        for messages in self._waiting.values():
            for message in messages:
                if self.interval.near_change(message.step) or message.step + self._most_late > last_step:
                    self._note(UNSETTLED, message)
                else:
                    self._withheld(DROPPED, message)
        for id_, messages in self._early.items():
            self._surplus(id_, [message for message in messages if not self.interval.near_change(message.step)])
        self._waiting.clear()
        self._early.clear()

    def _pair(self, id_: Id, received: Overheard, sent: Overheard) -> None:
        """Compare a message with what became of it."""
        self._sent[id_] = received.step
        if len(self._sent) > REMEMBERED:
            del self._sent[next(iter(self._sent))]
        late = sent.step - received.step
        if late > 0:
            self._most_late = max(self._most_late, late)
            self._withheld(DELAYED, received, frames_late=late)
        if not received.same_bytes(sent):
            self._compare(received, sent)

    def _compare(self, received: Overheard, sent: Overheard) -> None:
        header, changed = received.header, sent.header
        try:
            before = received.body
        except MessageError:  # no subscriber would have taken it anyway
            if received.payload != sent.payload:
                self._note(CORRUPTED, received)
            return
        try:
            after = sent.body
        except MessageError:
            self._withheld(CORRUPTED, received)
            return
        if changed.time_ns != header.time_ns:
            self._note(RESTAMPED, received, time_ns=changed.time_ns - header.time_ns)
        self._passed.append(Passed(header.frame, header.seq, received.step, before, after))
        if len(self._passed) >= BATCH:
            self._settle()

    def _settle(self) -> None:
        """Compare the bodies of the messages that were sent on changed; then they need not be kept."""
        if not self._passed:
            return
        changes, others = objects.changed(self.passage.message, self._passed)
        self.objects.append(changes)
        for each, names in zip(self._passed, others, strict=True):
            if names:
                self.effects.append(MessageEffect(REFRAMED, each.frame, each.seq, each.step, columns=names))
        self._passed = []

    def _surplus(self, id_: Id, messages: Sequence[Overheard]) -> None:
        """Messages were sent more often than they were received, or without having been received at all.

        Of several messages of one number a subscriber takes the first, which has been compared.
        """
        step = self._sent.get(id_)
        for message in messages:
            if step is None:
                self._forged(message)
            else:
                self.effects.append(MessageEffect(REPEATED, *id_, step, max(0, message.step - step)))

    def _withheld(self, effect: str, message: Overheard, frames_late: int = 0) -> None:
        """A message was received, and its subscribers got nothing that they could read, or got it too late."""
        self._note(effect, message, frames_late=frames_late)
        self._whole(message, received=True, frames_late=frames_late)

    def _forged(self, message: Overheard) -> None:
        """A message was sent that had not been received."""
        self._note(FORGED, message)
        self._whole(message, received=False)

    def _whole(self, message: Overheard, *, received: bool, frames_late: int = 0) -> None:
        try:
            header, body = message.header, message.body
        except MessageError:
            return
        bodies = {"received": body if received else None, "sent": None if received else body}
        made = objects.whole(
            self.passage.message, header.frame, header.seq, message.step, frames_late=frames_late, **bodies
        )
        self.objects.append(made)

    def _pair_unreadable(self) -> None:
        """What was sent and cannot be read: passed on as it came, a damaged copy of a message, or rubbish."""
        came, went = self._unreadable
        payloads = [message.payload for message in came]
        known = set(payloads)
        for message in went:
            payload = message.payload
            if payload in payloads:
                payloads.remove(payload)
                continue
            if payload in known:
                self.effects.append(MessageEffect(REPEATED, -1, -1, message.step))
                continue
            id_ = self._resembled(payload)
            if id_ is None:
                self.effects.append(MessageEffect(FORGED, -1, -1, message.step))
                continue
            self._withheld(CORRUPTED, _first(self._waiting, id_))
        step = came[0].step if came else -1
        self.effects += [MessageEffect(DROPPED, -1, -1, step)] * len(payloads)

    def _resembled(self, payload: bytes) -> Id | None:
        """The waiting message of which these bytes are a damaged copy."""
        for id_, messages in self._waiting.items():
            original = messages[0].payload
            equal = sum(a == b for a, b in zip(original, payload, strict=False))
            if equal >= SIMILAR * max(len(original), len(payload)):
                return id_
        return None

    def _note(
        self,
        effect: str,
        message: Overheard,
        *,
        frames_late: int = 0,
        time_ns: int = 0,
    ) -> None:
        header = message.header
        self.effects.append(MessageEffect(effect, header.frame, header.seq, message.step, frames_late, time_ns))


def _first(messages: dict[Id, list[Overheard]], id_: Id) -> Overheard:
    """Take out the first message of a number."""
    of_number = messages[id_]
    first = of_number.pop(0)
    if not of_number:
        del messages[id_]
    return first
