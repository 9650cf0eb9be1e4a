"""Queries whether a node has passed on all that it got, when a publisher is about to go around it.

    @control/drain/{node}    node → node    a query whose payload is the key of a leg to the node that is to leave

The query travels behind the last message on the same way, and its answer comes behind what followed from that message.
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

TIMEOUT_S = 2.0  #: after which a node that does not answer is not waited for
MAX_WAITING = 64  #: queries that wait for an answer at one node


def ask(
    session: zenoh.Session, prefix: str, put: Callable[[Event], None], node: str, key: str, outlet_key: str
) -> None:
    """Ask a node whether it has passed on all that was sent to it on a key, on the way of the messages, behind them.

    put: adds the event ("drained", outlet_key, node, whether it has answered in time) to the inbox
    """
    replies = list[zenoh.Reply]()

    def over() -> None:
        put(("drained", outlet_key, node, any(reply.ok for reply in replies)))

    handler: Any = zenoh.handlers.Callback(replies.append, over, indirect=False)
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
    """Answers these queries for one node.

    wiring:  that the node follows now; ports: of the node when it was started
    put:     adds an event to the inbox; refuse: counts a refused control message
    newest:  the last message of each key that has come; whatever takes them from the mesh writes it
    leaving: whether the node is about to leave: it takes part in no further epoch, but takes what comes until it goes
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
        self._waiting: list[tuple[zenoh.Query, str, int]] = []  # with the key, and the frame in which it came
        self._taken = 0  # in the current epoch

    @property
    def waiting(self) -> bool:
        """Whether a query waits for its answer."""
        return bool(self._waiting)

    def enter_epoch(self, *, leaving: bool) -> None:
        """A new epoch of a change begins."""
        self.leaving, self._taken = leaving, 0

    def take(self, query: zenoh.Query) -> None:
        """Take up a query, in Zenoh's thread.

        While this node is to leave, every node before it on a wire may ask. Any other query takes no room.
        """
        try:
            key = flow.decode_drain(query.payload.to_bytes() if query.payload else b"")
            if not self.leaving:
                raise MessageError(f"drain: {self._name} has not been told to leave")
            if key not in taps_into(self.wiring, (self._name,)):
                raise MessageError(f"drain: found {key!r:.80}, which {self._name} is not on")
            if self._taken >= MAX_WAITING:
                raise MessageError(f"drain: more than {MAX_WAITING} questions")
            self._taken += 1
        except MessageError as error:
            self._refuse(f"drain/{self._name}", error)
            query.drop()
        else:
            self._put(("drain", query, key))

    def begin(self, query: zenoh.Query, key: str) -> None:
        """Begin to wait for the answer of a query, in the main thread; what the node holds back leaves at once."""
        self._host.flush()
        self._waiting.append((query, key, self._host.frame))

    def answer(self) -> None:
        """Answer the queries whose messages have been passed on."""
        if not self._waiting:
            return
        still = []
        for query, key, frame in self._waiting:
            if self._passed_on(key, frame):
                query.reply(query.key_expr, b"")
                query.drop()
            else:
                still.append((query, key, frame))
        self._waiting = still

    def _passed_on(self, key: str, asked_in: int) -> bool:
        """Whether the node has dealt with what came on a key.

        It has if the newest message has gone out again. If it has not, the node has dropped it, or keeps it: until the
        next clock, because no node may keep a message for longer.
        """
        host = self._host
        if host.waiting:
            return False
        if host.frame > asked_in or not host.clocked or key not in self.newest:
            return True
        for wire in self.wiring.wires:
            for leg, onward in zip(wire.legs, wire.legs[1:], strict=False):
                if leg.key == key:
                    outlet_key = self._ports.outputs.get((onward.publisher.port, wire.subject))
                    out = self._outlets[outlet_key].newest if outlet_key else None
                    return _number(self.newest[key], wire.message) == _number(out, wire.message)
        return True


def _number(payload: bytes | None, message: str) -> int | None:
    """The sequence number of a message; None for no message, or one that is malformed."""
    try:
        return None if payload is None else codec.decode_header(payload, message).seq
    except MessageError:
        return None
