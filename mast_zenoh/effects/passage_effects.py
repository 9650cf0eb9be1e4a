"""Records the effects of one interposer on one wire, message by message."""

from __future__ import annotations

import numpy as np

from mast_zenoh.effects import objects
from mast_zenoh.effects.damaged import Id
from mast_zenoh.effects.message_effects import (
    CORRUPTED,
    DELAYED,
    FORGED,
    REFRAMED,
    REPEATED,
    RESTAMPED,
    MessageEffect,
    Spoof,
)
from mast_zenoh.effects.objects import ChangedMessage, ObjectChanges
from mast_zenoh.errors import MessageError
from mast_zenoh.gather import MAX_AGE_S
from mast_zenoh.wiring.received import Overheard

#: Changed messages that are compared at once.
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
        changes, (names,) = objects.changed_objects(self._type, [change])
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
        if len(self._pending) >= BATCH:
            self.settle()

    def settle(self) -> None:
        """Compare the bodies of the pending changed messages."""
        if not self._pending:
            return
        changes, others = objects.changed_objects(self._type, self._pending)
        self.objects.append(changes)
        for each, names in zip(self._pending, others, strict=True):
            self._note_pose(each, names)
            if names:
                self.messages.append(MessageEffect(REFRAMED, each.frame, each.seq, each.step, columns=names))
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
        predicted = {**body, "position": body["position"] - body["velocity"] * (shift_ns * 1e-9)}
        changes, _ = objects.changed_objects(
            self._type, [ChangedMessage(header.frame, header.seq, message.step, body, predicted)]
        )
        self.objects.append(changes._replace(whole=np.ones(len(changes.frame), bool)))

    def _add_whole(self, message: Overheard, *, received: bool, frames_late: int = 0) -> None:
        """Record the effect on all objects of a message only received, or only sent."""
        try:
            header, body = message.header, message.body
        except MessageError:
            return
        bodies = {"received": body if received else None, "sent": None if received else body}
        whole = objects.whole_message(
            self._type, header.frame, header.seq, message.step, frames_late=frames_late, **bodies
        )
        self.objects.append(whole)
