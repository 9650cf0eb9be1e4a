"""What a node's process receives and sends: stamps, the inbox, messages by epoch, and the outlets of its wires.

The stamp attached to a data message is the mark of the key on which it is sent, epoch and step. The step is that in
which the message was sent. An interposer's messages have the same stamp as the publisher's
would, so it does not reveal them.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from contextlib import AbstractContextManager
from typing import NamedTuple

from mast_zenoh.mesh.control.codec import Signatures
from mast_zenoh.mesh.control.key_marks import MARK, MARK_BYTES, ZenohAttachment, key_mark
from mast_zenoh.mesh.host import Host, Outgoing
from mast_zenoh.mesh.protocol.events import Actions, Clocks, DroppedEvent, Event, MessageEvent, NewestEvent
from mast_zenoh.mesh.waiting import EARLY, INBOX, Limit, Room
from mast_zenoh.wiring.model import Wiring

ATTACHMENT = struct.Struct(f"<{MARK_BYTES}sIq")

FOREIGN = -1, -1  #: stamp of a message that is not from this testbed
MISDIRECTED = -2, -2  #: stamp of one that was sent on another key than that on which it has arrived


def stamp(key: str, epoch: int, step: int) -> bytes:
    """The attachment of a message that is sent on a key."""
    return ATTACHMENT.pack(key_mark(key), epoch, step)


def stamp_of(attachment: ZenohAttachment | None, key: str) -> tuple[int, int]:
    """Epoch and step of the attachment of a message that has arrived on a key; else FOREIGN or MISDIRECTED."""
    if attachment is None or len(attachment) not in (ATTACHMENT.size, MARK_BYTES):
        return FOREIGN
    content = attachment.to_bytes()
    if len(content) == ATTACHMENT.size:
        mark, epoch, step = ATTACHMENT.unpack(content)
        if mark == key_mark(key):
            return epoch, step
    return MISDIRECTED if content.startswith(MARK) else FOREIGN


#: An event in the queue, with the source and the size of a message of a wire; size -1: of another event.
Item = tuple[Event, str, int]


class EventInbox:
    """Puts events into a queue.

    Messages of wires are limited by source. What a DroppedEvent or a NewestEvent says is as of when it is taken.

    put:  adds an item to the queue, from any thread
    lock: of what is counted here
    """

    def __init__(
        self, put: Callable[[Item], object], lock: AbstractContextManager[object], limit: Limit = INBOX
    ) -> None:
        self.room = Room(limit)
        self._put = put
        self._lock = lock
        self._dropped: Counter[tuple[str, int]] = Counter()
        self._newest: dict[tuple[type[NewestEvent], str], NewestEvent] = {}

    def put(self, event: Event) -> None:
        """Add an event that is not a message of a wire."""
        self._put((event, "", -1))

    def put_message(self, source: str, message: MessageEvent, epoch: int) -> bool:
        """Add a message; False if it is dropped: its source has no room left.

        epoch: in which it counts for lock-step
        """
        size = len(message.payload)
        with self._lock:
            if self.room.take(source, size):
                self._put((message, source, size))
                return True
            announced = bool(self._dropped)
            self._dropped[message.key, epoch] += 1
        if not announced:
            self.put(DroppedEvent({}))
        return False

    def put_newest(self, event: NewestEvent) -> None:
        """Add an event in the place of an older one of its kind and node, if that waits."""
        place = type(event), event.node
        with self._lock:
            waiting = self._newest.get(place)
            self._newest[place] = event if waiting is None else event.after(waiting)
        if waiting is None:
            self.put(event)

    def take(self, item: Item) -> Event:
        """The event of an item from the queue."""
        event, source, size = item
        if size >= 0:
            with self._lock:
                self.room.free(source, size)
        elif isinstance(event, NewestEvent):
            with self._lock:
                return self._newest.pop((type(event), event.node))
        elif isinstance(event, DroppedEvent):
            return DroppedEvent(self.take_dropped())
        return event

    def take_dropped(self) -> Counter[tuple[str, int]]:
        """Number of messages dropped since the last call, by key and epoch."""
        with self._lock:
            dropped, self._dropped = self._dropped, Counter()
        return dropped


class ProcessContext(NamedTuple):
    """What a protocol finds in its process.

    inbox: where `receive_…` put events
    process: its id, which distinguishes it from earlier and later ones of its node
    signatures: of control messages
    """

    actions: Actions
    inbox: EventInbox
    clocks: Clocks
    process: str
    signatures: Signatures


class Receiving:
    """Delivers messages of the current epoch and earlier ones; keeps those of later epochs until these begin.

    leaving: whether the node takes part in no later epoch
    newest:  the last message received on each key
    foreign: number of messages from outside this run, by key
    """

    def __init__(self, host: Host) -> None:
        self.epoch = 0
        self.leaving = False
        self.newest: dict[str, bytes] = {}
        self.foreign: Counter[str] = Counter()
        self._host = host
        self._early: list[MessageEvent] = []
        self._early_room = Room(EARLY)
        self._dropped_early: Counter[str] = Counter()  # messages of the next epoch, by key
        self._n_in_frame = 0  # messages received in this frame
        self._n_in_previous = (0, 0)  # and in the two before

    @property
    def started(self) -> bool:
        """Whether the host has started: with the first epoch."""
        return self.epoch > 0

    @property
    def expects_more(self) -> bool:
        """Whether fewer messages were received in this frame than in the two before."""
        return self._n_in_frame < min(self._n_in_previous)

    def counted_epoch(self, epoch: int) -> int:
        """The epoch of a message as long as lock-step may wait for it; else -1."""
        return epoch if epoch - self.epoch in (0, 1) else -1

    def receive(self, message: MessageEvent) -> None:
        """Receive a message."""
        frame = self._host.frame
        self.deliver(message)
        if self._host.frame != frame:
            self._n_in_previous = (self._n_in_previous[1], self._n_in_frame)
            self._n_in_frame = 0
        self._n_in_frame += 1

    def deliver(self, message: MessageEvent) -> None:
        """Deliver a message to the host, or keep it until its epoch."""
        key, epoch = message.key, message.epoch
        if epoch == MISDIRECTED[0]:
            self._host.drop(key, "wrong key: sent on another key, and delivered on this one by Zenoh")
        elif epoch < 0:
            self.foreign[key] += 1
            if self.started:
                self._host.deliver(key, message.payload, -1, counted=False)
        elif epoch > self.epoch and not self.leaving:
            self._keep(message)
        elif self.started:
            self.newest[key] = message.payload
            self._host.deliver(key, message.payload, message.step, counted=epoch == self.epoch)

    def note_dropped(self, dropped: Mapping[tuple[str, int], int]) -> None:
        """Count messages dropped by the inbox: as rejected, and for lock-step as handled."""
        for (key, epoch), count in dropped.items():
            reason = f"queued: more than {INBOX} of {self._host.publisher(key)} wait in the inbox"
            self._host.drop(key, reason, count=count, counted=count if epoch == self.epoch else 0)
            if epoch == self.epoch + 1:
                self._dropped_early[key] += count

    def enter_epoch(self, epoch: int) -> None:
        """Count from zero, except for messages of this epoch that were dropped already.

        Messages of epochs before a node's first one were not for this process: it has not seen what came before them.
        """
        self._host.reset_counts()
        if epoch == self.epoch + 1:
            self._host.handled.update(self._dropped_early)
        self._dropped_early.clear()
        if not self.started:
            self._early = [message for message in self._early if message.epoch >= epoch]
        self.epoch = epoch

    def deliver_early(self) -> None:
        """Deliver the messages that have waited for this epoch."""
        early, self._early, self._early_room = self._early, [], Room(EARLY)
        for message in early:
            self.deliver(message)

    def _keep(self, message: MessageEvent) -> None:
        source = self._host.publisher(message.key)
        if self._early_room.take(source, len(message.payload)):
            self._early.append(message)
            return
        self._host.drop(message.key, f"early: more than {EARLY} of {source} are of a later epoch")
        if message.epoch == self.epoch + 1:
            self._dropped_early[message.key] += 1


class Outlet:
    """One output of a node.

    key:    on which it is published now
    newest: the last message
    held:   messages held back, with epoch and step; None while they are not
    """

    def __init__(self, key: str) -> None:
        self.key = key
        self.newest: bytes | None = None
        self.held: list[tuple[bytes, int, int]] | None = None


class Outlets(dict[str, Outlet]):
    """All outlets of a node, by their initial keys, which the host uses throughout."""

    def __init__(self, wiring: Wiring, name: str, actions: Actions) -> None:
        super().__init__()
        self._name = name
        self._actions = actions
        for _, leg in wiring.legs():
            if leg.publisher.node == name:
                self[leg.key] = Outlet(leg.key)

    def declare(self, wiring: Wiring) -> None:
        """Declare the publishers of all outlets."""
        for wire, leg in wiring.legs():
            if leg.key in self:
                self._actions.declare(leg.key, wire.message)

    def send(self, message: Outgoing, epoch: int) -> None:
        """Publish a message immediately, or keep it while messages are held back; epoch: of its stamp."""
        assert isinstance(message.payload, bytes)
        outlet = self[message.key]
        outlet.newest = message.payload
        if outlet.held is None:
            self._actions.publish(outlet.key, message.payload, stamp(outlet.key, epoch, message.step))
        else:
            outlet.held.append((message.payload, epoch, message.step))

    def move(self, outlet: Outlet, key: str) -> int:
        """Publish on another key, beginning with held messages; returns their number."""
        previous, outlet.key = outlet.key, key
        held, outlet.held = outlet.held or [], None
        for payload, epoch, step in held:
            self._actions.publish(key, payload, stamp(key, epoch, step))
        self._actions.undeclare(previous)
        return len(held)

    def counted(self, sent: Mapping[str, int]) -> dict[str, int]:
        """Message counts by current key, computed from counts by initial key."""
        return {self[key].key if key in self else key: n for key, n in sent.items()}

    @property
    def keys_now(self) -> set[str]:
        """The keys on which they are published now."""
        return {outlet.key for outlet in self.values()}

    def received_by(self, members: Collection[str], keys: Collection[str], wiring: Wiring) -> set[str]:
        """Those of these keys of a wiring on which a member other than this node receives messages."""
        return {
            leg.key
            for wire, leg in wiring.legs()
            if leg.key in keys
            and {end.node for end in (*wire.receivers(leg), *wiring.overhearers)} & (set(members) - {self._name})
        }
