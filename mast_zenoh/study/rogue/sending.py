"""Sends forged control messages and waits for replies or timeouts."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import Any

import zenoh

from mast_zenoh.study.rogue.forgeries import QUERIES, Forgery

#: Maximum number of pending queries; below the launcher's limit per node.
_MAX_PENDING = 8

#: s, timeout of queries; those on permitted keys are answered in this time.
_ANSWER_S = 0.3


def send(session: zenoh.Session, prefix: str, messages: Iterable[Forgery]) -> int:
    """Send messages in order; returns how many the router accepted.

    prefix: of all keys of the run
    """
    slots, sent, pending = threading.Semaphore(_MAX_PENDING), 0, 0
    answers = threading.Semaphore(0)

    def answered() -> None:
        slots.release()
        answers.release()

    for message in messages:
        key = f"{prefix}/@control/{message.key}"
        try:
            if message.control in QUERIES:
                slots.acquire()
                handler: Any = zenoh.handlers.Callback(lambda reply: None, answered, indirect=False)
                session.get(key, handler, payload=message.payload, timeout=_ANSWER_S)
                pending += 1
            else:
                session.put(key, message.payload, congestion_control=zenoh.CongestionControl.BLOCK, express=True)
        except zenoh.ZError:  # the run is over
            break
        sent += 1
    for _ in range(pending):
        answers.acquire(timeout=10 * _ANSWER_S)
    return sent
