"""The driver's part in changing the wiring of a running mesh.

It makes one change at a time, in two epochs. The first announces it: the subscribers of a new key subscribe to it, and
its publisher declares it. When all nodes have reported this, the second begins: the new wiring is active, and each
publisher switches to its new key between two of its messages. In lock-step both epochs begin while the mesh is quiet.
In real time frames continue, and a publisher that is to bypass a released node holds its messages back until that node
has forwarded everything that it received; see `drain`.

    @control/rewire    launcher → driver    a query: the new wiring, which nodes join and leave; answered when done

`wiring_follower` is the part of each node, the driver included.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import zenoh

from mast_zenoh.control import flow
from mast_zenoh.control.flow import Rewire, WiringUpdate
from mast_zenoh.errors import MessageError
from mast_zenoh.runtime.lockstep.pacer import Pacer
from mast_zenoh.runtime.mesh.membership import Membership
from mast_zenoh.runtime.mesh.wiring_follower import WiringFollower
from mast_zenoh.wiring.model import Wiring

MAX_WAITING = 64  #: maximum number of queued changes
CHANGE_TIMEOUT_S = 20.0  #: for all nodes to report an epoch of a change


@dataclass
class Change:
    """A requested change of the wiring; frame: the first that may use the new wiring."""

    wiring: Wiring
    join: dict[str, str]
    leave: tuple[str, ...]
    query: zenoh.Query
    requested_at: float = field(default_factory=time.monotonic)
    started_at: float = 0.0
    frame: int = 0

    def reply(self, **answer: Any) -> None:
        """Answer the query with the outcome of the change."""
        self.query.reply(self.query.key_expr, flow.encode_rewired(**answer))
        self.query.drop()


class WiringCoordinator:
    """Carries out requested changes of the wiring one at a time.

    membership: of the nodes; those that join or leave are added to or removed from the expected ones
    pacer:      knows which nodes have not reported in the current epoch, and gets the wiring of the next
    follower:   the driver's own
    frame:      returns the next frame
    begin_epoch: begins an epoch with `update`
    update:     the wiring update in every epoch since the first change; None before
    """

    def __init__(
        self,
        membership: Membership,
        pacer: Pacer,
        follower: WiringFollower,
        log: logging.Logger,
        *,
        frame: Callable[[], int],
        begin_epoch: Callable[[], None],
    ) -> None:
        self.update: WiringUpdate | None = None
        self._membership = membership
        self._pacer = pacer
        self._follower = follower
        self._log = log
        self._frame = frame
        self._begin_epoch = begin_epoch
        self._waiting: deque[Change] = deque()
        self._change: Change | None = None
        self._epoch_began = 0.0  # monotonic clock, s

    def add(self, request: Rewire, query: zenoh.Query) -> None:
        """Queue a change, from any thread; raises MessageError if too many wait."""
        if len(self._waiting) >= MAX_WAITING:
            raise MessageError(f"rewire: more than {MAX_WAITING} changes wait")
        self._waiting.append(Change(*request, query))

    def advance(self) -> bool:
        """Advance the change as far as possible; returns whether it waits for reports."""
        change = self._change
        if change is None:
            return self._begin()
        assert self.update is not None
        timed_out = time.monotonic() - self._epoch_began > CHANGE_TIMEOUT_S
        if not self.update.active and not change.join.keys() <= self._membership.alive:
            return self._cancel(change, f"{', '.join(change.join)} ended before it took part")
        if self._pacer.silent or self._follower.busy:
            if timed_out and not self.update.active:
                return self._cancel(change, f"not ready within {CHANGE_TIMEOUT_S:.0f} s: {self._missing()}")
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
        change.reply(frame=change.frame, took_ms=round((time.monotonic() - change.started_at) * 1e3, 3))
        return self._begin()

    def _begin(self) -> bool:
        """Begin the next change once the joining nodes are alive; returns as `advance`."""
        if not self._waiting:
            return False
        change = self._waiting[0]
        if not change.join.keys() <= self._membership.alive:
            if time.monotonic() - change.requested_at > CHANGE_TIMEOUT_S:
                self._waiting.popleft().reply(error=f"{', '.join(change.join)} has not joined")
            return False
        self._change = self._waiting.popleft()
        change.started_at = time.monotonic()
        self._membership.expected |= change.join
        self._announce(WiringUpdate(change.wiring, False, change.leave))
        return True

    def _cancel(self, change: Change, reason: str) -> bool:
        """Cancel a change before any node has switched: the wiring remains unchanged."""
        for name in change.join:
            self._membership.expected.pop(name, None)
        self._change = None
        self._announce(WiringUpdate(self._follower.wiring, True))
        change.reply(error=reason)
        return False

    def _announce(self, update: WiringUpdate) -> None:
        """Begin an epoch with this update."""
        self.update = update
        self._epoch_began = time.monotonic()
        self._pacer.rewire(update.wiring)
        self._begin_epoch()

    def _missing(self) -> str:
        return ", ".join(sorted(self._pacer.silent)) or self._membership.own
