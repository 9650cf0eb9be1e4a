"""The outputs of a node as publishers on the mesh."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import zenoh

from mast_zenoh.messages.schemas import SCHEMAS
from mast_zenoh.wiring.model import Wiring

_MATCH_TIMEOUT_S = 10.0


class Outlet:
    """One output of a node.

    key: the current key;  newest: the last published message
    """

    def __init__(self, key: str, publisher: zenoh.Publisher) -> None:
        self.key = key
        self.publisher = publisher
        self.newest: bytes | None = None
        self._kept: list[tuple[bytes, bytes]] | None = None

    def put(self, payload: bytes, attachment: bytes) -> None:
        """Publish a message, or keep it while messages are held back."""
        self.newest = payload
        if self._kept is None:
            self.publisher.put(payload, attachment=attachment)
        else:
            self._kept.append((payload, attachment))

    def hold_back(self) -> None:
        """Keep messages until the outlet moves."""
        self._kept = []

    def move(self, key: str, publisher: zenoh.Publisher) -> int:
        """Publish on another key, beginning with held messages; returns their number."""
        previous, self.key, self.publisher = self.publisher, key, publisher
        kept, self._kept = self._kept or [], None
        for payload, attachment in kept:
            publisher.put(payload, attachment=attachment)
        previous.undeclare()
        return len(kept)


class Outlets(dict[str, Outlet]):
    """All outlets of a node, by their initial keys, which the host uses throughout.

    prefix: of all keys of the run
    lockstep: whether messages block rather than being dropped. In real time, an unreachable subscriber would block the
        router for all others.
    """

    def __init__(self, session: zenoh.Session, prefix: str, log: logging.Logger, *, lockstep: bool) -> None:
        super().__init__()
        self._session = session
        self._prefix = prefix
        self._log = log
        self._congestion = zenoh.CongestionControl.BLOCK if lockstep else zenoh.CongestionControl.DROP

    def add(self, key: str, message: str) -> None:
        """Declare an outlet for messages of this type."""
        self[key] = Outlet(key, self.declare_publisher(key, message))

    def declare_publisher(self, key: str, message: str) -> zenoh.Publisher:
        """Declare a publisher of a wire on one of its keys; all legs have equal settings."""
        schema = SCHEMAS[message]
        return self._session.declare_publisher(
            f"{self._prefix}/{key}",
            encoding=f"application/msgpack;schema={schema.name}.{schema.version}",
            congestion_control=self._congestion,
            express=True,
        )

    def subscribed(self, wiring: Wiring, name: str, without: Collection[str]) -> list[zenoh.Publisher]:
        """Publishers of the legs of node `name` that have subscribers.

        without: nodes that are not running
        """
        return [
            self[leg.key].publisher
            for wire, leg in wiring.legs()
            if leg.publisher.node == name
            and {end.node for end in (*wire.receivers(leg), *wiring.overhearers)} - set(without)
        ]

    def counted(self, sent: Mapping[str, int]) -> dict[str, int]:
        """Message counts by current key, computed from counts by initial key."""
        return {self[key].key if key in self else key: n for key, n in sent.items()}

    def await_subscribers(self, publishers: Sequence[zenoh.Publisher]) -> None:
        """Wait until each publisher has a subscriber; after a timeout, warn and continue."""
        pending = threading.Semaphore(0)
        direct: Any = zenoh.handlers.Callback(lambda status: pending.release(), indirect=False)
        listeners = [publisher.declare_matching_listener(direct) for publisher in publishers]
        deadline = time.monotonic() + _MATCH_TIMEOUT_S
        while missing := [publisher for publisher in publishers if not publisher.matching_status]:
            remaining_s = deadline - time.monotonic()
            if remaining_s <= 0:
                names = ", ".join(str(publisher.key_expr) for publisher in missing)
                self._log.warning("no subscriber for %s after %.0f s; continuing", names, _MATCH_TIMEOUT_S)
                break
            pending.acquire(timeout=min(remaining_s, 0.1))
        for listener in listeners:
            listener.undeclare()
