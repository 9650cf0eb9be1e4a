"""A node's protocol by itself: the test plays the mesh and the clock."""

from collections import deque
from contextlib import nullcontext
from typing import Any
from unittest.mock import MagicMock

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.mesh.control.codec import Signatures
from mast_zenoh.mesh.protocol.driver import protocol_of
from mast_zenoh.mesh.protocol.events import Actions, Clocks
from mast_zenoh.mesh.protocol.traffic import EventInbox, Item, ProcessContext
from mast_zenoh.node import Node
from mast_zenoh.wiring.model import Wiring


class Hosted:
    """A node of run "x".

    protocol: of the node; a DriverProtocol for a Source
    actions:  records what it asks for; all its publishers have subscribers
    items:    what waits in the inbox;  now_ns: its clock
    """

    def __init__(self, name: str, node: Node, wiring: Wiring, **fields: Any) -> None:
        self.now_ns = 0
        self.items: deque[Item] = deque()
        self.actions = MagicMock(spec=Actions)
        self.actions.unmatched.return_value = set()
        self.inbox = EventInbox(self.items.append, nullcontext())
        clocks = Clocks(lambda: self.now_ns, lambda: 0.0)
        fields = dict(seed=1, mode="lockstep", rate=1.0, frames=1, period_ns=1, nodes={}, scene={}) | fields
        context = ProcessContext(self.actions, self.inbox, clocks, "p", Signatures("x"))
        resolved = Resolved(**{"name": "x", "wiring": wiring.to_json(), **fields})
        self.protocol: Any = protocol_of(resolved, name, node, context)

    def handle_one(self) -> None:
        """Handle the next event in the inbox."""
        self.protocol.handle(self.inbox.take(self.items.popleft()))

    def handle_all(self) -> None:
        """Handle all events in the inbox."""
        while self.items:
            self.handle_one()

    def wait(self) -> float:
        """Let the time pass after which the protocol is due, without an event; returns it, s."""
        seconds = self.protocol.idle()
        assert seconds is not None, "it waits for an event"
        self.now_ns += round(seconds * 1e9)
        self.protocol.handle(None)
        return float(seconds)

    def controls(self, kind: str) -> list[bytes]:
        """The control messages that it has sent on a key."""
        return [call.args[1] for call in self.actions.control.call_args_list if call.args[0] == kind]
