"""Matches the received and sent messages of every interposer on every wire, and records its effects."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.errors import MessageError
from mast_zenoh.evaluation.effects import rows
from mast_zenoh.evaluation.effects.rows import ChangedMessage, ObjectChanges
from mast_zenoh.evaluation.effects.scans import POINTS
from mast_zenoh.gather import MAX_AGE_S
from mast_zenoh.messages.schemas import same_columns
from mast_zenoh.wiring.model import InterposedWire, Wiring
from mast_zenoh.wiring.received import Overheard

#: Effects on whole messages.
DELAYED, DROPPED, REPEATED, CORRUPTED, RESTAMPED, REFRAMED, FORGED, UNSETTLED, SLANDERED = MESSAGE_EFFECTS = (
    "delayed",
    "dropped",
    "repeated",
    "corrupted",
    "restamped",
    "reframed",
    "forged",
    "unsettled",
    "slandered",
)

#: Number of frames by which nodes may differ, in real time, about the time of a live wiring change.
CHANGE_FRAMES = 2


class MessageEffect(NamedTuple):
    """The effect of an interposer on one message.

    effect:  one of MESSAGE_EFFECTS
    frame, seq: of the message; -1 if unreadable
    step:    frame in which the interposer received it (forged: sent it)
    frames_late: delay in frames
    time_ns: ns, change of the time in its header
    columns: names of the changed columns, except columns with a row for each object
    """

    effect: str
    frame: int
    seq: int
    step: int
    frames_late: int = 0
    time_ns: int = 0
    columns: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class FrameSpan:
    """The frames in which a passage is part of the wiring.

    From `begin`, before `end` (None: to the end of the run).
    """

    begin: int
    end: int | None = None

    def contains(self, step: int) -> bool:
        """Whether a message sent in a step passed through."""
        return self.begin <= step and (self.end is None or step < self.end)

    def near_change(self, step: int) -> bool:
        """Whether the passage was added or removed when a message was sent."""
        return (self.begin > 0 and step < self.begin + CHANGE_FRAMES) or (
            self.end is not None and step >= self.end - CHANGE_FRAMES
        )


class Spoof(NamedTuple):
    """A pose that an interposer changed.

    Position (3,) m and quaternion (4,) in a frame, before and after.
    """

    frame: int
    position: Floats
    rotation: Floats
    false_position: Floats
    false_rotation: Floats


#: Identifies a message of a wire's publisher: frame and sequence number.
Id = tuple[int, int]

#: Fraction of equal bytes from which one message counts as a damaged copy of another.
SIMILAR = 0.9
#: Number of recent messages to compare with a damaged one.
COMPARED = 32


def find_original(waiting: Mapping[Id, Sequence[Overheard]], damaged: Overheard) -> Id | None:
    """The original of a damaged message.

    The most similar of the newest unsent messages before it.

    waiting: by number, the messages that have not been sent on yet, the newest last
    """
    candidates = [(id_, messages[0]) for id_, messages in waiting.items() if messages[0].step <= damaged.step]
    similarities = [
        (_similarity(message.payload, damaged.payload), index)
        for index, (_, message) in enumerate(candidates[-COMPARED:])
    ]
    similarity, index = max(similarities, default=(0.0, 0))
    return candidates[-COMPARED:][index][0] if similarity >= SIMILAR else None


def _similarity(a: bytes, b: bytes) -> float:
    """Number of equal bytes divided by the length of the longer one."""
    longer, shorter = max(len(a), len(b)), min(len(a), len(b))
    if shorter < SIMILAR * longer:
        return 0.0
    equal = np.frombuffer(a, np.uint8, shorter) == np.frombuffer(b, np.uint8, shorter)
    return float(np.count_nonzero(equal)) / longer if longer else 1.0


#: Changed messages that are compared at once; scans are too large to wait.
BATCH = 64

#: ns; a change of a message's time by more counts for its objects, too. This applies to the message types whose
#: receivers use the time in the header; for the others they use the frame.
RESTAMPED_NS = 50_000_000
TIMED = ("tracks", "picture")
#: ns; the broker, by default, predicts tracks whose time differs by less, so that their objects move. Others count as
#: withheld.
PREDICTED_NS = round(MAX_AGE_S * 1e9)


class PassageEffects:
    """The effects of an interposer on messages of one type.

    messages: effects on whole messages; objects: on the objects in them; spoofs: on poses

    Bodies are compared in batches; `settle` compares the remaining ones and must be called at the end.
    """

    def __init__(self, message: str) -> None:
        """message: the message type"""
        self.messages: list[MessageEffect] = []
        self.objects: list[ObjectChanges] = []
        self.spoofs: list[Spoof] = []
        self._type = message
        self._pending: list[ChangedMessage] = []  # changed messages that have not been compared yet

    def note(self, effect: str, message: Overheard, *, frames_late: int = 0, time_ns: int = 0) -> None:
        """Record an effect on a message but not on its objects."""
        header = message.header
        self.messages.append(MessageEffect(effect, header.frame, header.seq, message.step, frames_late, time_ns))

    def note_unreadable(self, effect: str, step: int) -> None:
        """Record an effect on a message with an unreadable header."""
        self.messages.append(MessageEffect(effect, -1, -1, step))

    def note_withheld(self, effect: str, message: Overheard, frames_late: int = 0) -> None:
        """Record a message that its subscribers got too late, unreadable or not at all."""
        self.note(effect, message, frames_late=frames_late)
        self._add_whole(message, received=True, frames_late=frames_late)

    def note_delay(self, received: Overheard, sent: Overheard) -> int:
        """Record the delay of a message, if any; returns it in frames."""
        late = sent.step - received.step
        if late > 0:
            self.note_withheld(DELAYED, received, frames_late=late)
        return max(0, late)

    def note_renumbered(self, id_: Id, received: Overheard, sent: Overheard) -> None:
        """Record a message that was sent on with another number than `id_`."""
        self.messages.append(MessageEffect(REFRAMED, *id_, received.step, columns=("seq",)))
        self.note_delay(received, sent)

    def note_repeated(self, id_: Id, received_step: int, sent: Overheard) -> None:
        """Record that a message, received in a frame and sent on, was sent again."""
        self.messages.append(MessageEffect(REPEATED, *id_, received_step, max(0, sent.step - received_step)))

    def note_forged(self, message: Overheard, rival: Overheard | None) -> None:
        """Record a message that was sent without having been received.

        Subscribers use the first message about a frame: if it pre-empts another, its `rival`, all differences count.
        """
        self.note(FORGED, message)
        if rival is None:
            self._add_whole(message, received=False)
            return
        header = message.header
        try:
            change = ChangedMessage(header.frame, header.seq, message.step, rival.body, message.body)
        except MessageError:
            return
        changes, (names,) = rows.changed_objects(self._type, [change])
        self._note_pose(change, names)
        self.objects.append(changes._replace(whole=np.ones(len(changes.frame), bool)))

    def compare(self, received: Overheard, sent: Overheard) -> None:
        """Record the differences of a message that was sent on with other bytes.

        They may be computed in a later batch.
        """
        header, changed = received.header, sent.header
        try:
            before = received.body
        except MessageError:  # subscribers would have rejected it anyway
            self.note(CORRUPTED, received)
            return
        try:
            after = sent.body
        except MessageError:
            self.note_withheld(CORRUPTED, received)
            return
        if changed.time_ns != header.time_ns:
            shift_ns = changed.time_ns - header.time_ns
            self.note(RESTAMPED, received, time_ns=shift_ns)
            if abs(shift_ns) > RESTAMPED_NS and self._type in TIMED:
                self._add_restamped(received, shift_ns)
        self._pending.append(ChangedMessage(header.frame, header.seq, received.step, before, after))
        if len(self._pending) >= (1 if self._type == POINTS else BATCH):
            self.settle()

    def forget(self, before: int) -> None:
        """Forget the effects on messages that the interposer received before this frame of the run."""
        self.settle()
        self.messages = [message for message in self.messages if message.step >= before]
        self.objects = [kept for changes in self.objects if len((kept := changes.since(before)).step)]
        self.spoofs = [spoof for spoof in self.spoofs if spoof.frame >= before]

    def settle(self) -> None:
        """Compare the bodies of the pending changed messages."""
        if not self._pending:
            return
        changes, others = rows.changed_objects(self._type, self._pending)
        self.objects.append(changes)
        for each, names in zip(self._pending, others, strict=True):
            self._note_pose(each, names)
            if names:
                effect = SLANDERED if self._type == "gossip" else REFRAMED
                self.messages.append(MessageEffect(effect, each.frame, each.seq, each.step, columns=names))
        self._pending = []

    def _note_pose(self, change: ChangedMessage, names: tuple[str, ...]) -> None:
        """Record a changed pose of an agent."""
        if names and self._type == "pose":
            before, after = ([body[name].copy() for name in ("position", "rotation")] for body in change[3:])
            self.spoofs.append(Spoof(change.frame, *before, *after))

    def _add_restamped(self, message: Overheard, shift_ns: int) -> None:
        """Record what a change of the time in a message's header does to its objects."""
        if self._type != "tracks" or abs(shift_ns) > PREDICTED_NS:
            self._add_whole(message, received=True)
            return
        header, body = message.header, message.body
        shift_s, covariance = shift_ns * 1e-9, body["covariance"].copy()
        covariance[:, :3, :3] += shift_s**2 * covariance[:, 6:, 6:]  # what stands is less certain, too, and lost sooner
        predicted = {**body, "position": body["position"] - body["velocity"] * shift_s, "covariance": covariance}
        changes, _ = rows.changed_objects(
            self._type, [ChangedMessage(header.frame, header.seq, message.step, body, predicted)]
        )
        self.objects.append(changes._replace(whole=np.ones(len(changes.frame), bool)))

    def _add_whole(self, message: Overheard, *, received: bool, frames_late: int = 0) -> None:
        """Record the effect on all objects of a message only received, or only sent."""
        try:
            header, body = message.header, message.body
        except MessageError:
            return
        whole = rows.whole_message(self._type, header, message.step, body, received=received, frames_late=frames_late)
        self.objects.append(whole)


#: Maximum number of unmatched messages of a passage; beyond that, the oldest is classified without a counterpart.
MAX_WAITING = 4096
#: REMEMBERED: number of messages kept after they were sent on, to recognise repetitions; of older ones only the numbers
#: are kept. KNOWN_FRAMES: number of frames after which a sent message is no longer matched with a received one.
REMEMBERED, KNOWN_FRAMES = 128, 64
#: Number of frames after which a message that has not been sent on counts as dropped, at 10 frames a second.
LATEST = 100
#: Fraction of the messages of a passage that must have at least this delay for it to be usual.
USUAL_SHARE = 0.05
#: Maximum number of remembered message numbers.
MAX_NUMBERS = 65_536


class PassageMeter:
    """Compares the sent and received messages of one interposer on a wire.

    The order of arrival does not matter. A message that is sent on more than `latest` frames after it was received
    counts as dropped, and then as repeated.
    effects: the measured effects; received: number of received messages
    """

    def __init__(self, passage: InterposedWire, interval: FrameSpan, latest: int = LATEST) -> None:
        self.passage = passage
        self.latest = latest
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
        id_ = self._number_of(message, self._unreadable[0])
        if id_ is None:
            return
        if id_ in self._unmatched_sent:
            self._pair(id_, message, _pop_first(self._unmatched_sent, id_))
            return
        if self._first_sent.get(id_[0], id_) != id_:
            self._note_preempted(id_[0], message)
        self._waiting.setdefault(id_, []).append(message)
        if len(self._waiting) > MAX_WAITING:
            for oldest in self._waiting.pop(next(iter(self._waiting))):
                self.effects.note_withheld(DROPPED, oldest)

    def take_sent(self, message: Overheard) -> None:
        """Add a message that the interposer has sent."""
        id_ = self._number_of(message, self._unreadable[1])
        if id_ is None:
            return
        if id_ in self._waiting:
            self._first_sent.setdefault(id_[0], id_)
            received = _pop_first(self._waiting, id_)
            if message.step - received.step <= self.latest:
                self._pair(id_, received, message)
                return
            self._note_dropped(id_, received)
        first = self._first_sent.setdefault(id_[0], id_)
        if first == id_:
            rival = next((messages[0] for number, messages in self._waiting.items() if number[0] == id_[0]), None)
            if rival is not None:
                self._note_preempted(id_[0], rival)
        self._unmatched_sent.setdefault(id_, []).append(message)
        if id_ in self._sent:
            self._repeated[id_] = self._sent[id_]
        if len(self._unmatched_sent) > MAX_WAITING:
            oldest = next(iter(self._unmatched_sent))
            self._classify_unmatched(oldest, self._unmatched_sent.pop(oldest))

    def _number_of(self, message: Overheard, unreadable: list[Overheard]) -> Id | None:
        """The frame and number of a new message, after older ones have been classified; None: it is unreadable."""
        try:
            header = message.header
        except MessageError:
            unreadable.append(message)
            return None
        self._expire(message.step)
        return header.frame, header.seq

    def close(self, last_step: int) -> None:
        """End the run after frame `last_step`: classify the unmatched messages."""
        self.effects.settle()
        self._pair_unreadable()
        for id_, messages in self._unmatched_sent.items():
            self._classify_unmatched(id_, messages)
        usual_delay = self._usual_delay()
        for id_, messages in self._waiting.items():
            for message in messages:
                unsettled = message.step + usual_delay > last_step  # it might still have been sent on
                self._note_dropped(id_, message, UNSETTLED if unsettled else DROPPED)
        self._waiting.clear()
        self._unmatched_sent.clear()

    def settle(self, before: int) -> None:
        """Classify the messages that were received before this frame of the run and not sent on until now.

        All messages of the `latest` frames from this one on must have been added.
        """
        self.effects.settle()
        self._pair_unreadable(before - 1)
        self._expire(before + KNOWN_FRAMES)
        for id_, messages in [*self._waiting.items()]:
            for message in [message for message in messages if message.step < before]:
                _pop_first(self._waiting, id_)  # they are in the order of their steps
                self._note_dropped(id_, message)
        for frame in [frame for frame in self._first_sent if frame < before - KNOWN_FRAMES]:
            del self._first_sent[frame]
        for id_ in [id_ for id_ in self._repeated if id_[0] < before - KNOWN_FRAMES]:
            del self._repeated[id_]

    def _note_dropped(self, id_: Id, message: Overheard, effect: str = DROPPED) -> None:
        """Record that a message was received and not sent on in time."""
        if self.interval.near_change(message.step):
            self.effects.note(UNSETTLED, message)
        elif self._rivals.get(message.header.frame) is message:
            self.effects.note(DROPPED, message)  # subscribers used the forged one instead
        else:
            self.effects.note_withheld(effect, message)
        self._old_numbers[id_] = message.step

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

    def _pair_unreadable(self, last_step: float = math.inf) -> None:
        """Match unreadable messages that were sent up to a frame of the run.

        They are relayed unreadable messages, damaged copies, or forgeries.
        """
        every = self._unreadable
        received, sent = ([message for message in messages if message.step <= last_step] for messages in every)
        for messages in every:
            messages[:] = [message for message in messages if message.step > last_step]
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


class Meter:
    """Compares the sent with the received messages of every interposer on every wire.

    It needs every message on the relevant keys, in any order that preserves the order on each key.
    """

    def __init__(self) -> None:
        self._latest = LATEST
        self._meters: list[PassageMeter] = []
        self._active: dict[InterposedWire, PassageMeter] = {}
        self._into: dict[str, list[PassageMeter]] = {}
        self._out_of: dict[str, list[PassageMeter]] = {}

    @property
    def meters(self) -> list[PassageMeter]:
        """The meters of all passages ever in the wiring, in order of appearance."""
        return self._meters

    def keys(self) -> set[str]:
        """The keys whose messages it needs."""
        return self._into.keys() | self._out_of.keys()

    def follow(self, wiring: Wiring, first_step: int) -> None:
        """Use a wiring from frame `first_step` onwards."""
        now = dict.fromkeys(wiring.passages())
        for passage in self._active.keys() - now.keys():
            meter = self._active.pop(passage)
            meter.interval = replace(meter.interval, end=first_step)
        for passage in now:
            if passage not in self._active:
                meter = PassageMeter(passage, FrameSpan(first_step), self._latest)
                self._active[passage] = meter
                self._meters.append(meter)
                self._into.setdefault(passage.received, []).append(meter)
                self._out_of.setdefault(passage.sent, []).append(meter)

    def add(self, message: Overheard) -> None:
        """Add a message; messages from outside the run are ignored."""
        key, step = message.key, message.step
        if step < 0:
            return
        if key in self._into:
            for meter in self._into[key]:
                if meter.interval.contains(step):
                    meter.take_received(message)
        if key in self._out_of:
            for meter in self._out_of[key]:
                if meter.interval.contains(step):
                    meter.take_sent(message)

    def allow(self, latest: int) -> None:
        """Take messages that are sent on up to so many frames later as delayed, see `PassageMeter`."""
        self._latest = latest
        for meter in self._meters:
            meter.latest = latest

    def settle(self, before: int) -> None:
        """Classify what was received before a frame of the run, see `PassageMeter.settle`."""
        for meter in self._meters:
            meter.settle(before)

    def forget(self, before: int) -> None:
        """Forget the effects on messages that interposers received before this frame of the run."""
        for meter in self._meters:
            meter.effects.forget(before)

    def close(self, last_step: int) -> None:
        """End the measurement after the last frame `last_step`."""
        for meter in self._meters:
            meter.close(last_step)
