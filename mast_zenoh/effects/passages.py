"""Matches the received and sent messages of one interposer on one wire."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from mast_zenoh.effects.damaged import Id, find_original
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

#: Maximum number of unmatched messages of a passage; beyond that, the oldest is classified without a counterpart.
MAX_WAITING = 4096
#: REMEMBERED: number of messages kept after they were sent on, to recognise repetitions; of older ones only the numbers
#: are kept. KNOWN_FRAMES: number of frames after which a sent message is no longer matched with a received one.
REMEMBERED, KNOWN_FRAMES = 128, 64
#: Fraction of the messages of a passage that must have at least this delay for it to be usual.
USUAL_SHARE = 0.05
#: Maximum number of remembered message numbers.
MAX_NUMBERS = 65_536


class PassageMeter:
    """Compares the sent and received messages of one interposer on a wire.

    The order of arrival does not matter.
    effects: the measured effects; received: number of received messages
    """

    def __init__(self, passage: Passage, interval: Interval) -> None:
        self.passage = passage
        self.interval = interval
        self.effects = PassageEffects(passage.message)
        self.received = 0
        self._waiting: dict[Id, list[Overheard]] = {}  # received but not sent on yet
        self._unmatched_sent: dict[Id, list[Overheard]] = {}  # sent without a matching received message (yet)
        self._sent: dict[Id, tuple[int, Overheard]] = {}  # by number: the step of reception, and the sent message
        self._old_numbers: dict[Id, int] = {}  # by number: the step of reception of older messages
        self._repeated: dict[Id, tuple[int, Overheard]] = {}  # as `_sent`, for repeated messages
        self._unreadable: tuple[list[Overheard], list[Overheard]] = [], []  # received and sent
        self._first_sent: dict[int, Id] = {}  # by frame: the number of the first message sent about it
        self._rivals: dict[int, Overheard] = {}  # by frame: the message that another one pre-empted
        self._delays: Counter[int] = Counter()  # number of messages by delay in frames

    def take_received(self, message: Overheard) -> None:
        """Add a message that the interposer has received."""
        self.received += 1
        try:
            header = message.header
        except MessageError:
            self._unreadable[0].append(message)
            return
        id_ = header.frame, header.seq
        self._expire(message.step)
        if id_ in self._unmatched_sent:
            self._pair(id_, message, _pop_first(self._unmatched_sent, id_))
            return
        if self._first_sent.get(header.frame, id_) != id_:
            self._note_preempted(header.frame, message)
        self._waiting.setdefault(id_, []).append(message)
        if len(self._waiting) > MAX_WAITING:
            for oldest in self._waiting.pop(next(iter(self._waiting))):
                self.effects.note_withheld(DROPPED, oldest)

    def take_sent(self, message: Overheard) -> None:
        """Add a message that the interposer has sent."""
        try:
            header = message.header
        except MessageError:
            self._unreadable[1].append(message)
            return
        id_ = header.frame, header.seq
        self._expire(message.step)
        if id_ in self._waiting:
            self._first_sent.setdefault(header.frame, id_)
            self._pair(id_, _pop_first(self._waiting, id_), message)
            return
        first = self._first_sent.setdefault(header.frame, id_)
        if first == id_:
            rival = next((messages[0] for number, messages in self._waiting.items() if number[0] == header.frame), None)
            if rival is not None:
                self._note_preempted(header.frame, rival)
        self._unmatched_sent.setdefault(id_, []).append(message)
        if id_ in self._sent:
            self._repeated[id_] = self._sent[id_]
        if len(self._unmatched_sent) > MAX_WAITING:
            oldest = next(iter(self._unmatched_sent))
            self._classify_unmatched(oldest, self._unmatched_sent.pop(oldest))

    def close(self, last_step: int) -> None:
        """End the run after frame `last_step`: classify the unmatched messages."""
        self.effects.settle()
        self._pair_unreadable()
        for id_, messages in self._unmatched_sent.items():
            self._classify_unmatched(id_, messages)
        usual_delay = self._usual_delay()
        for messages in self._waiting.values():
            for message in messages:
                if self.interval.near_change(message.step):
                    self.effects.note(UNSETTLED, message)
                elif self._rivals.get(message.header.frame) is message:
                    self.effects.note(DROPPED, message)  # subscribers used the forged one instead
                elif message.step + usual_delay > last_step:
                    self.effects.note_withheld(UNSETTLED, message)  # it might still have been sent on
                else:
                    self.effects.note_withheld(DROPPED, message)
        self._waiting.clear()
        self._unmatched_sent.clear()

    def _expire(self, step: int) -> None:
        """Classify unmatched messages that were sent too long ago to be matched."""
        while self._unmatched_sent:
            oldest = next(iter(self._unmatched_sent))
            if self._unmatched_sent[oldest][0].step >= step - KNOWN_FRAMES:
                return
            self._classify_unmatched(oldest, self._unmatched_sent.pop(oldest))

    def _match_renumbered(self, sent: Overheard) -> bool:
        """Whether this is a received message that was sent on with another number."""
        frame = sent.header.frame
        waiting = (
            id_ for id_, messages in self._waiting.items() if id_[0] == frame and _same_content(messages[0], sent)
        )
        id_ = next(waiting, None)
        if id_ is None:
            return False
        self.effects.note_renumbered(id_, _pop_first(self._waiting, id_), sent)
        return True

    def _pair(self, id_: Id, received: Overheard, sent: Overheard) -> None:
        """Record the differences between a received message and its sent version."""
        self._sent.setdefault(id_, (received.step, sent))  # subscribers use the first of several
        if id_ in self._unmatched_sent:
            self._repeated[id_] = self._sent[id_]
        if len(self._sent) > REMEMBERED:
            oldest = next(iter(self._sent))
            self._old_numbers[oldest] = self._sent.pop(oldest)[0]
            if len(self._old_numbers) > MAX_NUMBERS:
                del self._old_numbers[next(iter(self._old_numbers))]
        if delay := self.effects.note_delay(received, sent):
            self._delays[delay] += 1
        if not received.same_bytes(sent):
            self.effects.compare(received, sent)

    def _note_preempted(self, frame: int, message: Overheard) -> None:
        """Record that another message about its frame was sent before this one."""
        self._rivals[frame] = message
        if len(self._rivals) > REMEMBERED:
            del self._rivals[next(iter(self._rivals))]

    def _usual_delay(self) -> int:
        """The largest delay in frames that at least USUAL_SHARE of all messages had."""
        required, count_so_far = USUAL_SHARE * self.received, 0
        for delay, count in sorted(self._delays.items(), reverse=True):
            count_so_far += count
            if count_so_far >= required:
                return delay
        return 0

    def _classify_unmatched(self, id_: Id, messages: Sequence[Overheard]) -> None:
        """Classify messages that were sent without a matching received message.

        A repetition with other content is forged; for old messages only the number can be compared.
        """
        known = self._repeated.get(id_)
        for message in messages:
            if self._bypassed(message):
                continue
            received_step = self._old_numbers.get(id_)
            if received_step is None and known is not None and known[1].same_bytes(message):
                received_step = known[0]
            if received_step is not None:
                self.effects.note_repeated(id_, received_step, message)
            elif known is not None or not self._match_renumbered(message):
                preempts = self._first_sent.get(message.header.frame) == id_
                self.effects.note_forged(message, self._rivals.get(message.header.frame) if preempts else None)

    def _bypassed(self, message: Overheard) -> bool:
        """Whether a message may have bypassed the interposer as it was added or removed."""
        return self.interval.near_change(message.step) and abs(message.header.frame - message.step) <= CHANGE_FRAMES

    def _pair_unreadable(self) -> None:
        """Match unreadable sent messages.

        They are relayed unreadable messages, damaged copies, or forgeries.
        """
        received, sent = self._unreadable
        unmatched = [(message.payload, message.step) for message in received]
        known = {payload for payload, _ in unmatched}
        for message in sent:
            payload = message.payload
            if (match := next((candidate for candidate in unmatched if candidate[0] == payload), None)) is not None:
                unmatched.remove(match)
                continue
            if payload in known:
                self.effects.note_unreadable(REPEATED, message.step)
                continue
            id_ = find_original(self._waiting, message)
            if id_ is None:
                self.effects.note_unreadable(FORGED, message.step)
                continue
            self.effects.note_withheld(CORRUPTED, _pop_first(self._waiting, id_))
        for _, step in unmatched:
            self.effects.note_unreadable(DROPPED, step)


def _same_content(a: Overheard, b: Overheard) -> bool:
    """Whether two messages about the same frame are equal except for their numbers."""
    try:
        return a.header._replace(seq=b.header.seq) == b.header and same_columns(a.body, b.body)
    except MessageError:
        return False


def _pop_first(messages: dict[Id, list[Overheard]], id_: Id) -> Overheard:
    """Remove and return the first message with the number `id_`."""
    same_number = messages[id_]
    first = same_number.pop(0)
    if not same_number:
        del messages[id_]
    return first
