"""The driver's part in changing the wiring of a running mesh.

It makes one change at a time, in two epochs. The first announces it: the subscribers of a new key subscribe to it, and
its publisher declares it. When all nodes have reported this, the second begins: the new wiring is active, and each
publisher switches to its new key between two of its messages. In lock-step both epochs begin while the mesh is quiet.
In real time frames continue, and a publisher that is to bypass a released node holds its messages back until that node
has forwarded everything that it received.

    @control/rewire    launcher → driver    a query: the new wiring, which nodes join and leave; answered when done

`wiring_follower` is the part of each node, the driver included.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mast_zenoh.control.codec import encode
from mast_zenoh.control.flow import Rewire, Rewired, WiringUpdate
from mast_zenoh.errors import MessageError
from mast_zenoh.runtime.protocol.actions import Actions, Query
from mast_zenoh.runtime.protocol.membership import Membership
from mast_zenoh.runtime.protocol.pacer import Pacer
from mast_zenoh.runtime.protocol.wiring_follower import WiringFollower
from mast_zenoh.wiring.model import Wiring

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
