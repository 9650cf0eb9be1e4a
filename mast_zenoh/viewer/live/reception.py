"""Receives copies of a run's messages, and keeps only the newest of each key.

Zenoh itself fills a ring for each key, and drops the oldest: no message waits for Python, so neither this process nor
what it does with a frame can hold back the run.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import zenoh

from mast_zenoh.runtime.protocol.traffic import stamp_of

#: Messages of a key that wait in its ring, and that are kept after they were taken from it.
KEPT = 16


class Sample(NamedTuple):
    """A message as it arrived. step: frame of the run in which it was sent"""

    step: int
    payload: bytes


class Reception:
    """The newest messages of some keys.

    prefix: of all keys of the run
    frames: number of frames that the run can have: a message with a later step is forged; None: not known
    """

    def __init__(self, session: zenoh.Session, prefix: str, frames: int | None = None) -> None:
        self._session = session
        self._end = 1 << 62 if frames is None else frames
        self._prefix = prefix
        self._subscribers: dict[str, Any] = {}
        self._kept: dict[str, deque[tuple[int, Any]]] = {}

    def subscribe(self, keys: Iterable[str]) -> None:
        """Receive exactly these keys from now on."""
        wanted = dict.fromkeys(keys)
        for key in self._subscribers.keys() - wanted.keys():
            self._subscribers.pop(key).undeclare()
            self._kept.pop(key)
        for key in wanted:
            if key not in self._subscribers:
                ring: Any = zenoh.handlers.RingChannel(KEPT)
                self._subscribers[key] = self._session.declare_subscriber(f"{self._prefix}/{key}", ring)
                self._kept[key] = deque(maxlen=KEPT)

    def poll(self) -> None:
        """Take what has arrived; messages from outside the run are left out."""
        for key, subscriber in self._subscribers.items():
            kept = self._kept[key]
            while (sample := subscriber.handler.try_recv()) is not None:
                _, step = stamp_of(sample.attachment)
                if 0 <= step < self._end:
                    kept.append((step, sample.payload))

    def newest_step(self, key: str) -> int:
        """The step of the newest message of a key; -1: there is none."""
        kept = self._kept.get(key)
        return kept[-1][0] if kept else -1

    def steps(self, key: str) -> list[int]:
        """The steps of the kept messages of a key, the oldest first."""
        return [step for step, _ in self._kept.get(key, ())]

    def newest(self, key: str) -> bytes | None:
        """The newest message of a key."""
        kept = self._kept.get(key)
        return kept[-1][1].to_bytes() if kept else None

    def sent_since(self, step: int) -> Iterator[tuple[str, Sample]]:
        """Key and content of the kept messages that were sent in a step or later, in the order of each key."""
        for key, kept in self._kept.items():
            for sent, payload in kept:
                if sent >= step:
                    yield key, Sample(sent, payload.to_bytes())

    def close(self) -> None:
        """Unsubscribe."""
        self.subscribe(())
