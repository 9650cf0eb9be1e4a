"""One interposer on one wire: what it sent on, compared message by message with what it received."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from mast_zenoh.effects.damaged import Id, resembled
from mast_zenoh.effects.message_effects import (
    CHANGE_FRAMES,
    CORRUPTED,
    DROPPED,
    FORGED,
    REPEATED,
    UNSETTLED,
    Interval,
)
from mast_zenoh.effects.passage_effects import PassageEffects
from mast_zenoh.errors import MessageError
from mast_zenoh.messages.schemas import same_columns
from mast_zenoh.wiring.model import Passage
from mast_zenoh.wiring.received import Overheard

#: Messages of one passage that wait for their counterpart; beyond these the oldest is judged without it.
MOST_WAITING = 4096
#: Messages that are kept after they were sent on, so that they are recognised when they are sent again; of older ones
#: only their numbers are. A message that was sent so many frames ago is not still on its way to be received.
REMEMBERED, KNOWN_FRAMES = 128, 64
#: Share of the messages of a passage that must be as late for it to be a usual delay.
USUAL_SHARE = 0.05
#: Numbers of messages that were sent on, that are remembered.
MOST_NUMBERS = 65_536


class PassageMeter:
    """Compares what one interposer sends on a wire with what it receives there, in whatever order both are heard.

    effects: what it did to them; received: how many messages came in
    """

    def __init__(self, passage: Passage, interval: Interval) -> None:
        self.passage = passage
        self.interval = interval
        self.effects = PassageEffects(passage.message)
        self.received = 0
        self._waiting: dict[Id, list[Overheard]] = {}  # received, and not sent on yet
        self._early: dict[Id, list[Overheard]] = {}  # sent, and not known to have been received
        self._sent: dict[Id, tuple[int, Overheard]] = {}  # by number: when it was received, and what was sent on
        self._passed_on: dict[Id, int] = {}  # when those were received that were sent on long ago
        self._again: dict[Id, tuple[int, Overheard]] = {}  # the same of those that were sent again
        self._unreadable: tuple[list[Overheard], list[Overheard]] = [], []  # received and sent
        self._first_sent: dict[int, Id] = {}  # by frame the number of the message about it that was sent first
        self._rivals: dict[int, Overheard] = {}  # by frame the message that another one forestalled
        self._late: Counter[int] = Counter()  # messages by how many frames late they were sent on

    def take_received(self, message: Overheard) -> None:
        """The interposer has received a message."""
        self.received += 1
        try:
            header = message.header
        except MessageError:
            self._unreadable[0].append(message)
            return
        id_ = header.frame, header.seq
        self._expire(message.step)
        if id_ in self._early:
            self._pair(id_, message, _first(self._early, id_))
            return
        if self._first_sent.get(header.frame, id_) != id_:
            self._forestalled(header.frame, message)
        self._waiting.setdefault(id_, []).append(message)
        if len(self._waiting) > MOST_WAITING:
            for oldest in self._waiting.pop(next(iter(self._waiting))):
                self.effects.withhold(DROPPED, oldest)

    def take_sent(self, message: Overheard) -> None:
        """The interposer has sent a message."""
        try:
            header = message.header
        except MessageError:
            self._unreadable[1].append(message)
            return
        id_ = header.frame, header.seq
        self._expire(message.step)
        if id_ in self._waiting:
            self._first_sent.setdefault(header.frame, id_)
            self._pair(id_, _first(self._waiting, id_), message)
            return
        first = self._first_sent.setdefault(header.frame, id_)
        if first == id_:
            rival = next((held[0] for other, held in self._waiting.items() if other[0] == header.frame), None)
            if rival is not None:
                self._forestalled(header.frame, rival)
        self._early.setdefault(id_, []).append(message)
        if id_ in self._sent:
            self._again[id_] = self._sent[id_]
        if len(self._early) > MOST_WAITING:
            oldest = next(iter(self._early))
            self._surplus(oldest, self._early.pop(oldest))

    def close(self, last_step: int) -> None:
        """The run is over, its last frame was `last_step`: judge what has found no counterpart."""
        self.effects.settle()
        self._pair_unreadable()
        for id_, messages in self._early.items():
            self._surplus(id_, messages)
        late = self._usual_delay()
        for messages in self._waiting.values():
            for message in messages:
                if self.interval.near_change(message.step):
                    self.effects.note(UNSETTLED, message)
                elif self._rivals.get(message.header.frame) is message:
                    self.effects.note(DROPPED, message)  # its subscribers had the forged one in its place
                elif message.step + late > last_step:
                    self.effects.withhold(UNSETTLED, message)  # nobody can tell whether it would still have come
                else:
                    self.effects.withhold(DROPPED, message)
        self._waiting.clear()
        self._early.clear()

    def _expire(self, step: int) -> None:
        """Judge what was sent so long ago that it is not still to be received."""
        while self._early:
            oldest = next(iter(self._early))
            if self._early[oldest][0].step >= step - KNOWN_FRAMES:
                return
            self._surplus(oldest, self._early.pop(oldest))

    def _renumbered(self, sent: Overheard) -> bool:
        """Whether a message that was received was sent on as this one, under another number: nobody can tell."""
        frame = sent.header.frame
        waiting = (id_ for id_, held in self._waiting.items() if id_[0] == frame and _same_content(held[0], sent))
        id_ = next(waiting, None)
        if id_ is None:
            return False
        self.effects.renumber(id_, _first(self._waiting, id_), sent)
        return True

    def _pair(self, id_: Id, received: Overheard, sent: Overheard) -> None:
        """Compare a message with what became of it."""
        self._sent.setdefault(id_, (received.step, sent))  # of several a subscriber takes the first
        if id_ in self._early:
            self._again[id_] = self._sent[id_]
        if len(self._sent) > REMEMBERED:
            oldest = next(iter(self._sent))
            self._passed_on[oldest] = self._sent.pop(oldest)[0]
            if len(self._passed_on) > MOST_NUMBERS:
                del self._passed_on[next(iter(self._passed_on))]
        if late := self.effects.hold_up(received, sent):
            self._late[late] += 1
        if not received.same_bytes(sent):
            self.effects.compare(received, sent)

    def _forestalled(self, frame: int, message: Overheard) -> None:
        """Another message about its frame was sent before this one."""
        self._rivals[frame] = message
        if len(self._rivals) > REMEMBERED:
            del self._rivals[next(iter(self._rivals))]

    def _usual_delay(self) -> int:
        """The most frames by which USUAL_SHARE of all messages were late: one late message excuses no others."""
        needed, later = USUAL_SHARE * self.received, 0
        for late, count in sorted(self._late.items(), reverse=True):
            later += count
            if later >= needed:
                return late
        return 0

    def _surplus(self, id_: Id, messages: Sequence[Overheard]) -> None:
        """Messages were sent more often than they were received, or without having been received at all.

        Sent again with another content, a message is forged; of one of long ago only the number is known.
        """
        known = self._again.get(id_)
        for message in messages:
            if self._of_change(message):
                continue
            received_step = self._passed_on.get(id_)
            if received_step is None and known is not None and known[1].same_bytes(message):
                received_step = known[0]
            if received_step is not None:
                self.effects.repeat(id_, received_step, message)
            elif known is not None or not self._renumbered(message):
                forestalls = self._first_sent.get(message.header.frame) == id_
                self.effects.forge(message, self._rivals.get(message.header.frame) if forestalls else None)

    def _of_change(self, message: Overheard) -> bool:
        """Whether a message may have gone past the passage while it came or went."""
        return self.interval.near_change(message.step) and abs(message.header.frame - message.step) <= CHANGE_FRAMES

    def _pair_unreadable(self) -> None:
        """What was sent and cannot be read: passed on as it came, a damaged copy of a message, or rubbish."""
        came, went = self._unreadable
        unmatched = [(message.payload, message.step) for message in came]
        known = {payload for payload, _ in unmatched}
        for message in went:
            payload = message.payload
            if (same := next((each for each in unmatched if each[0] == payload), None)) is not None:
                unmatched.remove(same)
                continue
            if payload in known:
                self.effects.note_unreadable(REPEATED, message.step)
                continue
            id_ = resembled(self._waiting, message)
            if id_ is None:
                self.effects.note_unreadable(FORGED, message.step)
                continue
            self.effects.withhold(CORRUPTED, _first(self._waiting, id_))
        for _, step in unmatched:
            self.effects.note_unreadable(DROPPED, step)


def _same_content(a: Overheard, b: Overheard) -> bool:
    """Whether two messages about one frame differ in nothing but their numbers."""
    try:
        return a.header._replace(seq=b.header.seq) == b.header and same_columns(a.body, b.body)
    except MessageError:
        return False


def _first(messages: dict[Id, list[Overheard]], id_: Id) -> Overheard:
    """Take out the first message of a number."""
    of_number = messages[id_]
    first = of_number.pop(0)
    if not of_number:
        del messages[id_]
    return first
