"""Sends forged control messages through a session, and waits until they are answered or have had time to be."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import Any

import zenoh

from mast_zenoh.study.rogue.forgeries import QUERIES, Forgery

#: Queries that may wait for their answers at a time: fewer than the launcher lets one node have.
_AT_A_TIME = 8

#: Seconds in which a query on a key that the insider may use is answered.
_ANSWER_S = 0.3


def send(session: zenoh.Session, prefix: str, messages: Iterable[Forgery]) -> int:
    """Send messages in their order; how many of them the router took.

    prefix: of all keys of the run
    """
    room, sent, waiting = threading.Semaphore(_AT_A_TIME), 0, 0
    over = threading.Semaphore(0)

    def answered() -> None:
        room.release()
        over.release()

    for message in messages:
        key = f"{prefix}/@control/{message.key}"
        try:
            if message.control in QUERIES:
                room.acquire()
                handler: Any = zenoh.handlers.Callback(lambda reply: None, answered, indirect=False)
                session.get(key, handler, payload=message.payload, timeout=_ANSWER_S)
                waiting += 1
            else:
                session.put(key, message.payload, congestion_control=zenoh.CongestionControl.BLOCK, express=True)
        except zenoh.ZError:  # the run is over
            break
        sent += 1
    for _ in range(waiting):
        over.acquire(timeout=10 * _ANSWER_S)
    return sent
