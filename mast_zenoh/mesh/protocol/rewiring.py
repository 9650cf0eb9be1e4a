"""Changes of the wiring of a running mesh: the driver's part, and that of each node.

The driver makes one change at a time, in two epochs. The first announces it: the subscribers of a new key subscribe to
it, and its publisher declares it. When all nodes have reported this, the second begins: the new wiring is active, and
each publisher switches to its new key between two of its messages. In lock-step both epochs begin while the mesh is
quiet. In real time frames continue, and a publisher that is to bypass a released node holds its messages back until
that node has forwarded everything that it received. It asks the node, after its last message on the same route; the
answer follows the messages that this one caused.

    @control/rewire          launcher → driver  a query: the new wiring, which nodes join and leave; answered when done
    @control/drain/{node}    node → node        a query whose payload is the key of a leg to the node that is to leave
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

from mast_zenoh.errors import MessageError
from mast_zenoh.mesh.control import flow
from mast_zenoh.mesh.control.codec import encode
from mast_zenoh.mesh.control.flow import Rewire, Rewired, WiringUpdate
from mast_zenoh.mesh.host import Host
from mast_zenoh.mesh.protocol.events import Actions, Query
from mast_zenoh.mesh.protocol.pacer import Membership, Pacer
from mast_zenoh.mesh.protocol.traffic import Outlets, Receiving
from mast_zenoh.messages import codec
from mast_zenoh.wiring.insertion import taps_into
from mast_zenoh.wiring.model import NO_WIRING, Ports, Wiring

MAX_CHANGES = 64  #: maximum number of queued changes
CHANGE_TIMEOUT_NS = 20_000_000_000  #: for all nodes to report an epoch of a change


@dataclass(eq=False)
class WiringChange:
    """A requested change of the wiring; frame: the first that may use the new wiring. Times in ns."""

    wiring: Wiring
    join: dict[str, str]
    leave: tuple[str, ...]
    query: Query
    requested_ns: int
    started_ns: int = 0
    frame: int = 0


@dataclass(eq=False)
class Rewiring:
    """Carries out requested changes of the wiring one at a time.

    membership: of the nodes; those that join or leave are added to or removed from the expected ones
    pacer:      knows which nodes have not reported in the current epoch, and gets the wiring of the next
    follower:   the driver's own
    now_ns:     a monotonic clock;  frame: returns the next frame
    begin_epoch: begins an epoch with `update`
    update:     the wiring update in every epoch since the first change; None before
    """

    membership: Membership
    pacer: Pacer
    follower: WiringFollower
    actions: Actions
    log: logging.Logger
    _: KW_ONLY
    now_ns: Callable[[], int]
    frame: Callable[[], int]
    begin_epoch: Callable[[], None]
    update: WiringUpdate | None = None
    _waiting: deque[WiringChange] = field(default_factory=deque)
    _change: WiringChange | None = None
    _epoch_began_ns: int = 0

    def add(self, request: Rewire, query: Query) -> str:
        """Queue a change; returns why it is refused if too many wait, else ""."""
        if len(self._waiting) >= MAX_CHANGES:
            return f"rewire: more than {MAX_CHANGES} changes wait"
        self._waiting.append(WiringChange(*request, query, self.now_ns()))
        return ""

    @property
    def due(self) -> bool:
        """Whether a change can begin or must be refused: its nodes have joined the mesh, or take too long."""
        return bool(self._waiting) and (self._joined(self._waiting[0]) or self._is_late(self._waiting[0]))

    def advance(self) -> bool:
        """Advance the change as far as possible; returns whether it waits for reports."""
        change = self._change
        if change is None:
            return self._begin()
        assert self.update is not None
        timed_out = self.now_ns() - self._epoch_began_ns > CHANGE_TIMEOUT_NS
        if not self.update.active and not self._joined(change):
            return self._cancel(change, f"{', '.join(change.join)} ended before it took part")
        if self.pacer.silent or self.follower.busy:
            if timed_out and not self.update.active:
                return self._cancel(change, f"not ready within {CHANGE_TIMEOUT_NS // 10**9} s: {self._missing()}")
            if not timed_out:
                return True
            self.log.warning("the wiring has changed, but without a report from %s", self._missing())
        if not self.update.active:
            for name in change.leave:
                self.membership.expected.pop(name, None)
            change.frame = self.frame()  # in real time the next may begin before all nodes report that they switched
            self._announce(WiringUpdate(change.wiring, True, change.leave))
            return True
        self.update = WiringUpdate(change.wiring, True)
        self._change = None
        took_ms = round((self.now_ns() - change.started_ns) * 1e-6, 3)
        self._reply(change, frame=change.frame, took_ms=took_ms)
        return self._begin()

    def _joined(self, change: WiringChange) -> bool:
        return change.join.keys() <= self.membership.alive

    def _is_late(self, change: WiringChange) -> bool:
        return self.now_ns() - change.requested_ns > CHANGE_TIMEOUT_NS

    def _begin(self) -> bool:
        """Begin the next change once the joining nodes are alive; returns as `advance`."""
        if not self._waiting:
            return False
        change = self._waiting[0]
        if not self._joined(change):
            if self._is_late(change):
                self._reply(self._waiting.popleft(), error=f"{', '.join(change.join)} has not joined")
            return False
        self._change = self._waiting.popleft()
        change.started_ns = self.now_ns()
        self.membership.expected |= change.join
        self._announce(WiringUpdate(change.wiring, False, change.leave))
        return True

    def _cancel(self, change: WiringChange, reason: str) -> bool:
        """Cancel a change before any node has switched: the wiring remains unchanged."""
        for name in change.join:
            self.membership.expected.pop(name, None)
        self._change = None
        self._announce(WiringUpdate(self.follower.wiring, True))
        self._reply(change, error=reason)
        return False

    def _announce(self, update: WiringUpdate) -> None:
        """Begin an epoch with this update."""
        self.update = update
        self._epoch_began_ns = self.now_ns()
        self.pacer.rewire(update.wiring)
        self.begin_epoch()

    def _reply(self, change: WiringChange, **answer: Any) -> None:
        """Answer the query with the outcome of a change."""
        self.actions.answer(change.query, encode(Rewired(**answer)))

    def _missing(self) -> str:
        return ", ".join(sorted(self.pacer.silent)) or self.membership.own


MAX_QUERIES = 64  #: maximum number of unanswered queries at one node


@dataclass(eq=False)
class WiringFollower:
    """Applies the wiring updates of epochs: subscribes to new keys, moves outlets, answers drain queries.

    ports:  of the node when it was started;  now_ns: a monotonic clock
    wiring: the node's current wiring
    next_keys: the keys to which outlets will move, by their initial keys
    """

    name: str
    host: Host
    ports: Ports
    outlets: Outlets
    receiving: Receiving
    actions: Actions
    _: KW_ONLY
    lockstep: bool
    now_ns: Callable[[], int]
    wiring: Wiring = NO_WIRING
    next_keys: dict[str, str] = field(default_factory=dict)
    _draining: dict[str, tuple[str, str, int]] = field(default_factory=dict)  # by key: outlet, interposer, since when
    _queries: list[tuple[Query, str, int]] = field(default_factory=list)  # unanswered: key, and frame of its arrival
    _accepted: int = 0  # queries, in the current epoch

    def __post_init__(self) -> None:
        self.wiring = self.host.wiring

    @property
    def busy(self) -> bool:
        """Whether an outlet still holds messages back."""
        return bool(self._draining)

    @property
    def questioned(self) -> bool:
        """Whether a drain query is unanswered."""
        return bool(self._queries)

    # -- changing the wiring ---------------------------------------------------------------------------------------

    def follow(self, update: WiringUpdate) -> None:
        """Apply the update of an epoch."""
        self._prepare(update.wiring)
        leaving = self.name in update.leaving
        self.receiving.leaving, self._accepted = leaving, 0
        if leaving and self.lockstep:
            self.host.flush()
        if update.active:
            self._switch(update)

    def resume(self, key: str, answered: bool) -> None:
        """Release the outlet of a key: the interposer has forwarded everything, or does not answer."""
        outlet_key, interposer, since_ns = self._draining.pop(key)
        held = self._move(outlet_key)
        held_ms = (self.now_ns() - since_ns) * 1e-6
        if answered:
            self.host.log.info("%d messages waited %.1f ms for %s", held, held_ms, interposer)
        else:
            self.host.log.warning(
                "%s has not confirmed within %.1f s that it forwarded everything: messages may be lost; %d waited",
                *(interposer, held_ms * 1e-3, held),
            )

    def _prepare(self, wiring: Wiring) -> None:
        """Subscribe to new keys, and declare publishers for keys that change."""
        ports = wiring.ports(self.name)
        for key, port_input in ports.inputs.items():
            if key not in self.host.subscriptions:
                self.host.add_input(key, port_input)
                self.actions.subscribe(key)
        types = {leg.key: wire.message for wire, leg in wiring.legs()}
        draining = {outlet_key for outlet_key, _, _ in self._draining.values()}
        for end, outlet_key in self.ports.outputs.items():
            key, current = ports.outputs.get(end, ""), self.outlets[outlet_key].key
            if outlet_key in draining or key == self.next_keys.get(outlet_key, current):
                continue
            if outlet_key in self.next_keys:  # of a cancelled change
                self.actions.undeclare(self.next_keys.pop(outlet_key))
            if key not in ("", current):
                self.next_keys[outlet_key] = key
                self.actions.declare(key, types[key])

    def _switch(self, update: WiringUpdate) -> None:
        """Publish on the new keys, now or after the interposer has forwarded everything."""
        taps = {} if self.lockstep else taps_into(self.wiring, update.leaving)
        draining = {outlet_key for outlet_key, _, _ in self._draining.values()}
        for outlet_key in [key for key in self.next_keys if key not in draining]:
            outlet = self.outlets[outlet_key]
            interposer = taps.get(outlet.key)
            if interposer is None:
                self._move(outlet_key)
            else:
                outlet.held = []
                self._draining[outlet.key] = outlet_key, interposer, self.now_ns()
                self.actions.ask_drained(interposer, outlet.key)
        self.wiring = update.wiring

    def _move(self, outlet_key: str) -> int:
        return self.outlets.move(self.outlets[outlet_key], self.next_keys.pop(outlet_key))

    # -- answering drain queries -------------------------------------------------------------------------------------

    def check_query(self, payload: bytes) -> str:
        """The key of a drain query, as it arrives; raises MessageError for an invalid one, which takes no room.

        While this node is about to leave, each node before it on a wire may send one.
        """
        key = flow.decode_drain(payload)
        if not self.receiving.leaving:
            raise MessageError(f"drain: {self.name} has not been told to leave")
        if key not in taps_into(self.wiring, (self.name,)):
            raise MessageError(f"drain: found {key!r:.80}, which {self.name} is not on")
        if self._accepted >= MAX_QUERIES:
            raise MessageError(f"drain: more than {MAX_QUERIES} queries")
        self._accepted += 1
        return key

    def begin_drain(self, query: Query, key: str) -> None:
        """Register a query, and send all delayed messages."""
        self.host.flush()
        self._queries.append((query, key, self.host.frame))

    def answer_queries(self) -> None:
        """Answer the queries whose messages have been forwarded."""
        for waiting in self._queries[:]:
            query, key, frame = waiting
            if self._forwarded(key, frame):
                self.actions.answer(query, b"")
                self._queries.remove(waiting)

    def _forwarded(self, key: str, query_frame: int) -> bool:
        """Whether the node has forwarded all messages received on a key.

        It has if the newest one has been sent on. Otherwise the node has dropped it, or keeps it until the next clock,
        which is the longest that a node may keep a message.
        """
        host, newest = self.host, self.receiving.newest
        if host.waiting:
            return False
        if host.frame > query_frame or not host.clocked or key not in newest:
            return True
        for wire in self.wiring.wires:
            for leg, onward in wire.hops:
                if leg.key == key:
                    outlet_key = self.ports.outputs.get((onward.publisher.port, wire.subject))
                    out = self.outlets[outlet_key].newest if outlet_key else None
                    return _number(newest[key], wire.message) == _number(out, wire.message)
        return True


def _number(payload: bytes | None, message: str) -> int | None:
    """The sequence number of a message; None for no message or a malformed one."""
    try:
        return None if payload is None else codec.decode_header(payload, message).seq
    except MessageError:
        return None
