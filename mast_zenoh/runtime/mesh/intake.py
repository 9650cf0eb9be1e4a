"""The samples of a node's wires, on their way from Zenoh's threads to the node's host."""

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
    """Puts samples into the inbox, and has the host handle those that the main thread takes out of it.

    prompt:  whether a sample is handled in the thread that brings it, if nothing waits before it
    epoch:   that the node is in; started: whether its host has started
    inside:  one thread at a time is inside the node
    taken:   samples that the main thread has taken from the inbox and handled; it counts them when it is outside again
    foreign: by key, messages that no node of this run has sent
    """

    def __init__(self, host: Host, inbox: Inbox, drains: DrainQueries, *, prompt: bool) -> None:
        self.prompt = prompt
        self.epoch = 0
        self.started = False
        self.inside = threading.RLock()
        self.taken = 0
        self.foreign: Counter[str] = Counter()
        self._host = host
        self._inbox = inbox
        self._drains = drains
        self._newest = drains.newest
        self._early = EarlyMessages()
        self._in_frame = 0  # messages that have come in this frame
        self._in_frames = (0, 0)  # and in the two before
        self._queued = 0  # samples put into the inbox, counted by Zenoh's thread

    @property
    def expects_more(self) -> bool:
        """Whether less has come in this frame than in the two before, so that more is likely to be on its way."""
        return self._in_frame < min(self._in_frames)

    def callback(self, key: str) -> Callable[[zenoh.Sample], None]:
        """What Zenoh's thread is to call with each sample of a key."""
        put = self._inbox.put_sample

        def on_sample(sample: zenoh.Sample) -> None:
            attachment = sample.attachment
            epoch, step = stamp_of(attachment.to_bytes() if attachment else None)
            came = key, sample.payload.to_bytes(), epoch, step
            if self.prompt and self._handled_at_once(*came):
                return
            counts = epoch if epoch - self.epoch in (0, 1) else -1
            if put(self._host.publisher(key), ("sample", *came), counts):
                self._queued += 1

        return on_sample

    def handle(self, key: str, payload: bytes, epoch: int, step: int) -> None:
        """Handle a sample from the inbox; epoch, step: as `stamp_of` tells them."""
        frame = self._host.frame
        self._deliver(key, payload, epoch, step)
        if self._host.frame != frame:
            self._in_frames = (self._in_frames[1], self._in_frame)
            self._in_frame = 0
        self._in_frame += 1

    def note_dropped(self) -> None:
        """Count what found no room in the inbox: as rejected, and for lock-step as handled."""
        for (key, epoch), count in self._inbox.take_dropped().items():
            reason = f"queued: more than {INBOX} of {self._host.publisher(key)} wait in the inbox"
            self._host.drop(key, reason, count=count, counted=count if epoch == self.epoch else 0)
            if epoch == self.epoch + 1:
                self._early.note_dropped(key, count)

    def enter_epoch(self, epoch: int) -> Counter[str]:
        """From now on messages of this epoch count. Returns how many of them have been dropped already, by key."""
        self.epoch = epoch
        return self._early.take_dropped()

    def deliver_early(self) -> None:
        """Deliver the messages that came before their epoch; those of an epoch still to come are kept again."""
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
        """Keep a message of an epoch that is still to come."""
        source = self._host.publisher(key)
        if self._early.keep(source, Early(key, payload, epoch, step)):
            return
        self._host.drop(key, f"early: more than {EARLY} of {source} are of an epoch to come")
        if epoch == self.epoch + 1:
            self._early.note_dropped(key)

    def _handled_at_once(self, key: str, payload: bytes, epoch: int, step: int) -> bool:
        """Handle a sample in the thread that brings it, unless another waits before it or the node is busy."""
        if self._queued != self.taken or not self.started or not self.inside.acquire(blocking=False):
            return False
        try:
            self._deliver(key, payload, epoch, step)
            due_s = self._host.release()
        finally:
            self.inside.release()
        if due_s is not None or self._drains.waiting:
            self._inbox.put(("due",))  # for the main thread
        return True
