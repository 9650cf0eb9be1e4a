"""The outputs of a node on the mesh: where each is published, and what is held back."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from mast_zenoh.runtime.host import Outgoing
from mast_zenoh.runtime.protocol.actions import Actions
from mast_zenoh.runtime.protocol.stamp import ATTACHMENT, MARK
from mast_zenoh.wiring.model import Wiring


class Outlet:
    """One output of a node.

    key:    on which it is published now
    newest: the last message
    held:   messages held back, with their attachments; None while they are not
    """

    def __init__(self, key: str) -> None:
        self.key = key
        self.newest: bytes | None = None
        self.held: list[tuple[bytes, bytes]] | None = None


class Outlets(dict[str, Outlet]):
    """All outlets of a node, by their initial keys, which the host uses throughout.

    epoch: of the messages sent now
    """

    def __init__(self, wiring: Wiring, name: str, actions: Actions) -> None:
        super().__init__()
        self.epoch = 0
        self._name = name
        self._actions = actions
        for _, leg in wiring.legs():
            if leg.publisher.node == name:
                self[leg.key] = Outlet(leg.key)

    def declare(self, wiring: Wiring) -> None:
        """Declare the publishers of all outlets."""
        for wire, leg in wiring.legs():
            if leg.key in self:
                self._actions.declare(leg.key, wire.message)

    def send(self, message: Outgoing) -> None:
        """Publish a message immediately, or keep it while messages are held back."""
        assert isinstance(message.payload, bytes)
        outlet = self[message.key]
        outlet.newest = message.payload
        attachment = ATTACHMENT.pack(MARK, self.epoch, message.step)
        if outlet.held is None:
            self._actions.publish(outlet.key, message.payload, attachment)
        else:
            outlet.held.append((message.payload, attachment))

    def move(self, outlet: Outlet, key: str) -> int:
        """Publish on another key, beginning with held messages; returns their number."""
        previous, outlet.key = outlet.key, key
        held, outlet.held = outlet.held or [], None
        for payload, attachment in held:
            self._actions.publish(key, payload, attachment)
        self._actions.undeclare(previous)
        return len(held)

    def counted(self, sent: Mapping[str, int]) -> dict[str, int]:
        """Message counts by current key, computed from counts by initial key."""
        return {self[key].key if key in self else key: n for key, n in sent.items()}

    @property
    def keys_now(self) -> set[str]:
        """The keys on which they are published now."""
        return {outlet.key for outlet in self.values()}

    def received_by(self, members: Collection[str], keys: Collection[str], wiring: Wiring) -> set[str]:
        """Those of these keys of a wiring on which a member other than this node receives messages."""
        return {
            leg.key
            for wire, leg in wiring.legs()
            if leg.key in keys
            and {end.node for end in (*wire.receivers(leg), *wiring.overhearers)} & (set(members) - {self._name})
        }
