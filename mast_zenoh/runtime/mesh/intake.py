"""Passes the samples of a node's wires from Zenoh's threads to the node's host."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable

import zenoh

from mast_zenoh.runtime.host import Host
from mast_zenoh.runtime.limits import EARLY, INBOX
from mast_zenoh.runtime.mesh.drain import DrainQueries
from mast_zenoh.runtime.mesh.early import Early, EarlyMessages
from mast_zenoh.runtime.mesh.inbox import Inbox
from mast_zenoh.runtime.mesh.stamp import stamp_of


class Intake:
    """Puts samples into the inbox, and passes those taken from it to the host.

    prompt:  whether a sample is handled in the receiving thread, if no other waits
    epoch:   the node's epoch; started: whether its host has started
    lock:    held by the thread that runs the node
    handled: samples from the inbox that the main thread has handled; it counts them after it released the lock
    foreign: number of messages from outside this run, by key
    """

    def __init__(self, host: Host, inbox: Inbox, drains: DrainQueries, *, prompt: bool) -> None:
        self.prompt = prompt
        self.epoch = 0
        self.started = False
        self.lock = threading.RLock()
        self.handled = 0
        self.foreign: Counter[str] = Counter()
        self._host = host
        self._inbox = inbox
        self._drains = drains
        self._newest = drains.newest
        self._early = EarlyMessages()
        self._n_in_frame = 0  # messages received in this frame
        self._n_in_previous = (0, 0)  # and in the two before
        self._queued = 0  # samples put into the inbox, counted by Zenoh's thread

    @property
    def expects_more(self) -> bool:
        """Whether fewer messages were received in this frame than in the two before."""
        return self._n_in_frame < min(self._n_in_previous)

    def callback(self, key: str) -> Callable[[zenoh.Sample], None]:
        """The callback for the samples of a key, for Zenoh's thread."""
        put = self._inbox.put_sample

        def on_sample(sample: zenoh.Sample) -> None:
            epoch, step = stamp_of(sample.attachment)
            arrived = key, sample.payload.to_bytes(), epoch, step
            if self.prompt and self._handle_promptly(*arrived):
                return
            counted_epoch = epoch if epoch - self.epoch in (0, 1) else -1
            if put(self._host.publisher(key), ("sample", *arrived), counted_epoch):
                self._queued += 1

        return on_sample

    def handle(self, key: str, payload: bytes, epoch: int, step: int) -> None:
        """Handle a sample from the inbox; epoch, step: as returned by `stamp_of`."""
        frame = self._host.frame
        self._deliver(key, payload, epoch, step)
        if self._host.frame != frame:
            self._n_in_previous = (self._n_in_previous[1], self._n_in_frame)
            self._n_in_frame = 0
        self._n_in_frame += 1

    def note_dropped(self) -> None:
        """Count samples dropped by the inbox: as rejected, and for lock-step as handled."""
        for (key, epoch), count in self._inbox.take_dropped().items():
            reason = f"queued: more than {INBOX} of {self._host.publisher(key)} wait in the inbox"
            self._host.drop(key, reason, count=count, counted=count if epoch == self.epoch else 0)
            if epoch == self.epoch + 1:
                self._early.note_dropped(key, count)

    def enter_epoch(self, epoch: int) -> Counter[str]:
        """Enter an epoch; returns the number of its messages dropped already, by key."""
        self.epoch = epoch
        return self._early.take_dropped()

    def deliver_early(self) -> None:
        """Deliver early messages of the current epoch; keep messages of later epochs."""
        for message in self._early.take():
            self._deliver(*message)

    def _deliver(self, key: str, payload: bytes, epoch: int, step: int) -> None:
        if epoch < 0:
            self.foreign[key] += 1
            if self.started:
                self._host.deliver(key, payload, -1, counted=False)
        elif epoch > self.epoch and not self._drains.leaving:
            self._keep_early(key, payload, epoch, step)
        elif self.started:
            self._newest[key] = payload
            self._host.deliver(key, payload, step, counted=epoch == self.epoch)

    def _keep_early(self, key: str, payload: bytes, epoch: int, step: int) -> None:
        """Keep a message of a later epoch."""
        source = self._host.publisher(key)
        if self._early.keep(source, Early(key, payload, epoch, step)):
            return
        self._host.drop(key, f"early: more than {EARLY} of {source} are of a later epoch")
        if epoch == self.epoch + 1:
            self._early.note_dropped(key)

    def _handle_promptly(self, key: str, payload: bytes, epoch: int, step: int) -> bool:
        """Handle a sample in the receiving thread; False if others wait or it is busy."""
        if self._queued != self.handled or not self.started or not self.lock.acquire(blocking=False):
            return False
        try:
            self._deliver(key, payload, epoch, step)
            due_s = self._host.release()
        finally:
            self.lock.release()
        if due_s is not None or self._drains.waiting:
            self._inbox.put(("due",))  # for the main thread
        return True
