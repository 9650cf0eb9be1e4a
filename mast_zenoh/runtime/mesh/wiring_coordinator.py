"""How the wiring of a running mesh changes, and the driver's part: it leads all nodes through one change at a time.

A change takes two epochs. In the first all nodes learn of it: the subscribers of a new key subscribe to it, and its
publisher declares it. When all have reported that they have, the second begins: the new wiring is active, and
publishers switch to their new keys, each between two of its own messages. In lock-step both begin while the mesh is
quiet. In real time frames go on, and a publisher that is to go around a node (which is released) holds its messages
back until that node has passed on all that it got; see `drain`.

    @control/rewire    launcher → driver    a query: the new wiring, which nodes join and leave; answered when done

`wiring_follower` is what each node does, the driver's own included.
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

MAX_WAITING = 64  #: changes that wait for those before
CHANGE_TIMEOUT_S = 20.0  #: how long the nodes may take to learn of a change


@dataclass
class Change:
    """A change of the wiring that has been requested; frame: the first that may go the new way."""

    wiring: Wiring
    join: dict[str, str]
    leave: tuple[str, ...]
    query: zenoh.Query
    requested: float = field(default_factory=time.monotonic)
    begun: float = 0.0
    frame: int = 0

    def reply(self, **answer: Any) -> None:
        """Answer the query with what has become of the change."""
        self.query.reply(self.query.key_expr, flow.encode_rewired(**answer))
        self.query.drop()


class WiringCoordinator:
    """Carries out requested changes of the wiring, one after the other.

    membership: of the nodes; those that join and leave become and stop being expected
    pacer:      says which nodes have not reported in the current epoch, and is told of the wiring of the next
    follower:   of the driver itself
    frame:      returns the frame that is sent next
    begin_epoch: begins an epoch, which says `update`
    update:     what every epoch says of the wiring since the first change; None before
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
        self._since = 0.0  # when the current epoch of the change began

    def add(self, request: Rewire, query: zenoh.Query) -> None:
        """Take up a change as soon as those before it are done; from any thread. Raises MessageError for too many."""
        if len(self._waiting) >= MAX_WAITING:
            raise MessageError(f"rewire: more than {MAX_WAITING} changes wait")
        self._waiting.append(Change(*request, query))

    def turn(self) -> bool:
        """Go on with the change as far as possible; whether it waits for reports of the nodes."""
        change = self._change
        if change is None:
            return self._begin()
        assert self.update is not None
        late = time.monotonic() - self._since > CHANGE_TIMEOUT_S
        if not self.update.active and not change.join.keys() <= self._membership.alive:
            return self._call_off(change, f"{', '.join(change.join)} ended before it took part")
        if self._pacer.silent or self._follower.busy:
            if late and not self.update.active:
                return self._call_off(change, f"not ready within {CHANGE_TIMEOUT_S:.0f} s: {self._missing()}")
            if not late:
                return True
            self._log.warning("the wiring has changed, but not a word from %s", self._missing())
        if not self.update.active:
            for name in change.leave:
                self._membership.expected.pop(name, None)
            change.frame = self._frame()  # in real time the next may begin before all nodes report that they switched
            self._epoch(WiringUpdate(change.wiring, True, change.leave))
            return True
        self.update = WiringUpdate(change.wiring, True)
        self._change = None
        change.reply(frame=change.frame, took_ms=round((time.monotonic() - change.begun) * 1e3, 3))
        return self._begin()

    def _begin(self) -> bool:
        """Begin the next change; the nodes that join must be there."""
        if not self._waiting:
            return False
        change = self._waiting[0]
        if not change.join.keys() <= self._membership.alive:
            if time.monotonic() - change.requested > CHANGE_TIMEOUT_S:
                self._waiting.popleft().reply(error=f"{', '.join(change.join)} is not there")
            return False
        self._change = self._waiting.popleft()
        change.begun = time.monotonic()
        self._membership.expected |= change.join
        self._epoch(WiringUpdate(change.wiring, False, change.leave))
        return True

    def _call_off(self, change: Change, why: str) -> bool:
        """Call off a change before any node has switched: the wiring stays as it was."""
        for name in change.join:
            self._membership.expected.pop(name, None)
        self._change = None
        self._epoch(WiringUpdate(self._follower.wiring, True))
        change.reply(error=why)
        return False

    def _epoch(self, update: WiringUpdate) -> None:
        self.update = update
        self._since = time.monotonic()
        self._pacer.rewire(update.wiring)
        self._begin_epoch()

    def _missing(self) -> str:
        return ", ".join(sorted(self._pacer.silent)) or self._membership.own
