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
from dataclasses import dataclass
from typing import Any

from mast_zenoh.control import flow
from mast_zenoh.control.codec import encode
from mast_zenoh.control.flow import Rewire, Rewired, WiringUpdate
from mast_zenoh.errors import MessageError
from mast_zenoh.messages import codec
from mast_zenoh.runtime.host import Host
from mast_zenoh.runtime.protocol.actions import Actions, Query
from mast_zenoh.runtime.protocol.pacer import Membership, Pacer
from mast_zenoh.runtime.protocol.traffic import Outlets, Receiving
from mast_zenoh.wiring.insertion import taps_into
from mast_zenoh.wiring.model import Ports, Wiring

MAX_WAITING = 64  #: maximum number of queued changes
CHANGE_TIMEOUT_NS = 20_000_000_000  #: for all nodes to report an epoch of a change


@dataclass
class Change:
    """A requested change of the wiring; frame: the first that may use the new wiring. Times in ns."""

    wiring: Wiring
    join: dict[str, str]
    leave: tuple[str, ...]
    query: Query
    requested_ns: int
    started_ns: int = 0
    frame: int = 0


class Rewiring:
    """Carries out requested changes of the wiring one at a time.

    membership: of the nodes; those that join or leave are added to or removed from the expected ones
    pacer:      knows which nodes have not reported in the current epoch, and gets the wiring of the next
    follower:   the driver's own
    now_ns:     a monotonic clock;  frame: returns the next frame
    begin_epoch: begins an epoch with `update`
    update:     the wiring update in every epoch since the first change; None before
    """

    def __init__(
        self,
        membership: Membership,
        pacer: Pacer,
        follower: WiringFollower,
        actions: Actions,
        log: logging.Logger,
        *,
        now_ns: Callable[[], int],
        frame: Callable[[], int],
        begin_epoch: Callable[[], None],
    ) -> None:
        self.update: WiringUpdate | None = None
        self._membership = membership
        self._pacer = pacer
        self._follower = follower
        self._actions = actions
        self._log = log
        self._now_ns = now_ns
        self._frame = frame
        self._begin_epoch = begin_epoch
        self._waiting: deque[Change] = deque()
        self._change: Change | None = None
        self._epoch_began_ns = 0

    def add(self, request: Rewire, query: Query) -> None:
        """Queue a change, from any thread; raises MessageError if too many wait."""
        if len(self._waiting) >= MAX_WAITING:
            raise MessageError(f"rewire: more than {MAX_WAITING} changes wait")
        self._waiting.append(Change(*request, query, self._now_ns()))

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
        timed_out = self._now_ns() - self._epoch_began_ns > CHANGE_TIMEOUT_NS
        if not self.update.active and not self._joined(change):
            return self._cancel(change, f"{', '.join(change.join)} ended before it took part")
        if self._pacer.silent or self._follower.busy:
            if timed_out and not self.update.active:
                return self._cancel(change, f"not ready within {CHANGE_TIMEOUT_NS // 10**9} s: {self._missing()}")
            if not timed_out:
                return True
            self._log.warning("the wiring has changed, but without a report from %s", self._missing())
        if not self.update.active:
            for name in change.leave:
                self._membership.expected.pop(name, None)
            change.frame = self._frame()  # in real time the next may begin before all nodes report that they switched
            self._announce(WiringUpdate(change.wiring, True, change.leave))
            return True
        self.update = WiringUpdate(change.wiring, True)
        self._change = None
        took_ms = round((self._now_ns() - change.started_ns) * 1e-6, 3)
        self._reply(change, frame=change.frame, took_ms=took_ms)
        return self._begin()

    def _joined(self, change: Change) -> bool:
        return change.join.keys() <= self._membership.alive

    def _is_late(self, change: Change) -> bool:
        return self._now_ns() - change.requested_ns > CHANGE_TIMEOUT_NS

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
        change.started_ns = self._now_ns()
        self._membership.expected |= change.join
        self._announce(WiringUpdate(change.wiring, False, change.leave))
        return True

    def _cancel(self, change: Change, reason: str) -> bool:
        """Cancel a change before any node has switched: the wiring remains unchanged."""
        for name in change.join:
            self._membership.expected.pop(name, None)
        self._change = None
        self._announce(WiringUpdate(self._follower.wiring, True))
        self._reply(change, error=reason)
        return False

    def _announce(self, update: WiringUpdate) -> None:
        """Begin an epoch with this update."""
        self.update = update
        self._epoch_began_ns = self._now_ns()
        self._pacer.rewire(update.wiring)
        self._begin_epoch()

    def _reply(self, change: Change, **answer: Any) -> None:
        """Answer the query with the outcome of a change."""
        self._actions.answer(change.query, encode(Rewired(**answer)))

    def _missing(self) -> str:
        return ", ".join(sorted(self._pacer.silent)) or self._membership.own


MAX_WAITING = 64  #: maximum number of unanswered queries at one node


class WiringFollower:
    """Applies the wiring updates of epochs: subscribes to new keys, moves outlets, answers drain queries.

    ports:  of the node when it was started;  now_ns: a monotonic clock
    wiring: the node's current wiring
    next_keys: the keys to which outlets will move, by their initial keys
    """

    def __init__(
        self,
        name: str,
        host: Host,
        ports: Ports,
        outlets: Outlets,
        receiving: Receiving,
        actions: Actions,
        *,
        lockstep: bool,
        now_ns: Callable[[], int],
    ) -> None:
        self.wiring = host.wiring
        self.next_keys: dict[str, str] = {}
        self._name = name
        self._host = host
        self._ports = ports
        self._outlets = outlets
        self._receiving = receiving
        self._actions = actions
        self._lockstep = lockstep
        self._now_ns = now_ns
        self._draining: dict[str, tuple[str, str, int]] = {}  # by key asked about: outlet, interposer, since when
        self._queries: list[tuple[Query, str, int]] = []  # unanswered, with the key, and the frame of its arrival
        self._accepted = 0  # queries, in the current epoch

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
        leaving = self._name in update.leaving
        self._receiving.leaving, self._accepted = leaving, 0
        if leaving and self._lockstep:
            self._host.flush()
        if update.active:
            self._switch(update)

    def resume(self, key: str, answered: bool) -> None:
        """Release the outlet of a key: the interposer has forwarded everything, or does not answer."""
        outlet_key, interposer, since_ns = self._draining.pop(key)
        held = self._move(outlet_key)
        held_ms = (self._now_ns() - since_ns) * 1e-6
        if answered:
            self._host.log.info("%d messages waited %.1f ms for %s", held, held_ms, interposer)
        else:
            self._host.log.warning(
                "%s has not confirmed within %.1f s that it forwarded everything: messages may be lost; %d waited",
                *(interposer, held_ms * 1e-3, held),
            )

    def _prepare(self, wiring: Wiring) -> None:
        """Subscribe to new keys, and declare publishers for keys that change."""
        ports = wiring.ports(self._name)
        for key, port_input in ports.inputs.items():
            if key not in self._host.subscriptions:
                self._host.add_input(key, port_input)
                self._actions.subscribe(key)
        types = {leg.key: wire.message for wire, leg in wiring.legs()}
        draining = {outlet_key for outlet_key, _, _ in self._draining.values()}
        for end, outlet_key in self._ports.outputs.items():
            key, current = ports.outputs.get(end, ""), self._outlets[outlet_key].key
            if outlet_key in draining or key == self.next_keys.get(outlet_key, current):
                continue
            if outlet_key in self.next_keys:  # of a cancelled change
                self._actions.undeclare(self.next_keys.pop(outlet_key))
            if key not in ("", current):
                self.next_keys[outlet_key] = key
                self._actions.declare(key, types[key])

    def _switch(self, update: WiringUpdate) -> None:
        """Publish on the new keys, now or after the interposer has forwarded everything."""
        taps = {} if self._lockstep else taps_into(self.wiring, update.leaving)
        draining = {outlet_key for outlet_key, _, _ in self._draining.values()}
        for outlet_key in [key for key in self.next_keys if key not in draining]:
            outlet = self._outlets[outlet_key]
            interposer = taps.get(outlet.key)
            if interposer is None:
                self._move(outlet_key)
            else:
                outlet.held = []
                self._draining[outlet.key] = outlet_key, interposer, self._now_ns()
                self._actions.ask_drained(interposer, outlet.key)
        self.wiring = update.wiring

    def _move(self, outlet_key: str) -> int:
        return self._outlets.move(self._outlets[outlet_key], self.next_keys.pop(outlet_key))

    # -- answering drain queries -------------------------------------------------------------------------------------

    def check_query(self, payload: bytes) -> str:
        """The key of a drain query, as it arrives; raises MessageError for an invalid one, which takes no room.

        While this node is about to leave, each node before it on a wire may send one.
        """
        key = flow.decode_drain(payload)
        if not self._receiving.leaving:
            raise MessageError(f"drain: {self._name} has not been told to leave")
        if key not in taps_into(self.wiring, (self._name,)):
            raise MessageError(f"drain: found {key!r:.80}, which {self._name} is not on")
        if self._accepted >= MAX_WAITING:
            raise MessageError(f"drain: more than {MAX_WAITING} queries")
        self._accepted += 1
        return key

    def begin_drain(self, query: Query, key: str) -> None:
        """Register a query, and send all delayed messages."""
        self._host.flush()
        self._queries.append((query, key, self._host.frame))

    def answer_queries(self) -> None:
        """Answer the queries whose messages have been forwarded."""
        for waiting in self._queries[:]:
            query, key, frame = waiting
            if self._forwarded(key, frame):
                self._actions.answer(query, b"")
                self._queries.remove(waiting)

    def _forwarded(self, key: str, query_frame: int) -> bool:
        """Whether the node has forwarded all messages received on a key.

        It has if the newest one has been sent on. Otherwise the node has dropped it, or keeps it until the next clock,
        which is the longest that a node may keep a message.
        """
        host, newest = self._host, self._receiving.newest
        if host.waiting:
            return False
        if host.frame > query_frame or not host.clocked or key not in newest:
            return True
        for wire in self.wiring.wires:
            for leg, onward in zip(wire.legs, wire.legs[1:], strict=False):
                if leg.key == key:
                    outlet_key = self._ports.outputs.get((onward.publisher.port, wire.subject))
                    out = self._outlets[outlet_key].newest if outlet_key else None
                    return _number(newest[key], wire.message) == _number(out, wire.message)
        return True


def _number(payload: bytes | None, message: str) -> int | None:
    """The sequence number of a message; None for no message or a malformed one."""
    try:
        return None if payload is None else codec.decode_header(payload, message).seq
    except MessageError:
        return None
