"""Passes the messages of a node's wires to its host, by epoch."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

from mast_zenoh.runtime.host import Host
from mast_zenoh.runtime.limits import EARLY, INBOX, Room


class Arrived(NamedTuple):
    """A message as it arrives; epoch, step: of its stamp."""

    key: str
    payload: bytes
    epoch: int
    step: int


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
        self._early: list[Arrived] = []
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

    def receive(self, key: str, payload: bytes, epoch: int, step: int) -> None:
        """Receive a message; epoch, step: as returned by `stamp_of`."""
        frame = self._host.frame
        self.deliver(key, payload, epoch, step)
        if self._host.frame != frame:
            self._n_in_previous = (self._n_in_previous[1], self._n_in_frame)
            self._n_in_frame = 0
        self._n_in_frame += 1

    def deliver(self, key: str, payload: bytes, epoch: int, step: int) -> None:
        """Deliver a message to the host, or keep it until its epoch."""
        if epoch < 0:
            self.foreign[key] += 1
            if self.started:
                self._host.deliver(key, payload, -1, counted=False)
        elif epoch > self.epoch and not self.leaving:
            self._keep(Arrived(key, payload, epoch, step))
        elif self.started:
            self.newest[key] = payload
            self._host.deliver(key, payload, step, counted=epoch == self.epoch)

    def note_dropped(self, dropped: Counter[tuple[str, int]]) -> None:
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
            self.deliver(*message)

    def _keep(self, message: Arrived) -> None:
        source = self._host.publisher(message.key)
        if self._early_room.take(source, len(message.payload)):
            self._early.append(message)
            return
        self._host.drop(message.key, f"early: more than {EARLY} of {source} are of a later epoch")
        if message.epoch == self.epoch + 1:
            self._dropped_early[message.key] += 1
