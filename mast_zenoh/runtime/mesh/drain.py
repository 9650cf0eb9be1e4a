"""Queries whether a node has forwarded everything, before a publisher bypasses it.

    @control/drain/{node}    node → node    a query whose payload is the key of a leg to the node that is to leave

The query follows the last message on the same route, and its answer follows the messages that this one caused.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import zenoh

from mast_zenoh.control import flow
from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec
from mast_zenoh.runtime.host import Host
from mast_zenoh.runtime.mesh.inbox import Event
from mast_zenoh.runtime.mesh.outlets import Outlets
from mast_zenoh.wiring.insertion import taps_into
from mast_zenoh.wiring.model import Ports, Wiring

TIMEOUT_S = 2.0  #: for an answer
MAX_WAITING = 64  #: maximum number of unanswered queries at one node


def ask(
    session: zenoh.Session, prefix: str, put: Callable[[Event], None], node: str, key: str, outlet_key: str
) -> None:
    """Ask a node whether it has forwarded all messages sent to it on a key.

    put: adds the event ("drained", outlet_key, node, whether it answered in time) to the inbox
    """
    replies = list[zenoh.Reply]()

    def finish() -> None:
        put(("drained", outlet_key, node, any(reply.ok for reply in replies)))

    handler: Any = zenoh.handlers.Callback(replies.append, finish, indirect=False)
    session.get(
        f"{prefix}/@control/drain/{node}",
        handler,
        payload=key,
        timeout=TIMEOUT_S,
        congestion_control=zenoh.CongestionControl.BLOCK,
        priority=zenoh.Priority.DATA,
        express=True,
    )


class DrainQueries:
    """Answers drain queries for one node.

    wiring:  the node's current wiring; ports: of the node when it was started
    put:     adds an event to the inbox; refuse: counts a refused control message
    newest:  the last message received on each key; written by the code that receives it
    leaving: whether the node is about to leave: it takes part in no later epoch, but still receives messages
    """

    def __init__(
        self,
        name: str,
        host: Host,
        ports: Ports,
        outlets: Outlets,
        wiring: Wiring,
        *,
        put: Callable[[Event], None],
        refuse: Callable[[str, object], None],
    ) -> None:
        self.wiring = wiring
        self.leaving = False
        self.newest: dict[str, bytes] = {}
        self._name = name
        self._host = host
        self._ports = ports
        self._outlets = outlets
        self._put = put
        self._refuse = refuse
        self._waiting: list[tuple[zenoh.Query, str, int]] = []  # with the key, and the frame of its arrival
        self._accepted = 0  # queries, in the current epoch

    @property
    def waiting(self) -> bool:
        """Whether a query is unanswered."""
        return bool(self._waiting)

    def enter_epoch(self, *, leaving: bool) -> None:
        """Begin a new epoch."""
        self.leaving, self._accepted = leaving, 0

    def take(self, query: zenoh.Query) -> None:
        """Receive a query, in Zenoh's thread; an invalid one takes no room.

        While this node is about to leave, each node before it on a wire may send one.
        """
        try:
            key = flow.decode_drain(query.payload.to_bytes() if query.payload else b"")
            if not self.leaving:
                raise MessageError(f"drain: {self._name} has not been told to leave")
            if key not in taps_into(self.wiring, (self._name,)):
                raise MessageError(f"drain: found {key!r:.80}, which {self._name} is not on")
            if self._accepted >= MAX_WAITING:
                raise MessageError(f"drain: more than {MAX_WAITING} queries")
            self._accepted += 1
        except MessageError as error:
            self._refuse(f"drain/{self._name}", error)
            query.drop()
        else:
            self._put(("drain", query, key))

    def begin(self, query: zenoh.Query, key: str) -> None:
        """Register a query, in the main thread, and send all delayed messages."""
        self._host.flush()
        self._waiting.append((query, key, self._host.frame))

    def answer(self) -> None:
        """Answer the queries whose messages have been forwarded."""
        if not self._waiting:
            return
        remaining = []
        for query, key, frame in self._waiting:
            if self._forwarded(key, frame):
                query.reply(query.key_expr, b"")
                query.drop()
            else:
                remaining.append((query, key, frame))
        self._waiting = remaining

    def _forwarded(self, key: str, query_frame: int) -> bool:
        """Whether the node has forwarded all messages received on a key.

        It has if the newest one has been sent on. Otherwise the node has dropped it, or keeps it until the next clock,
        which is the longest that a node may keep a message.
        """
        host = self._host
        if host.waiting:
            return False
        if host.frame > query_frame or not host.clocked or key not in self.newest:
            return True
        for wire in self.wiring.wires:
            for leg, onward in zip(wire.legs, wire.legs[1:], strict=False):
                if leg.key == key:
                    outlet_key = self._ports.outputs.get((onward.publisher.port, wire.subject))
                    out = self._outlets[outlet_key].newest if outlet_key else None
                    return _number(self.newest[key], wire.message) == _number(out, wire.message)
        return True


def _number(payload: bytes | None, message: str) -> int | None:
    """The sequence number of a message; None for no message or a malformed one."""
    try:
        return None if payload is None else codec.decode_header(payload, message).seq
    except MessageError:
        return None
