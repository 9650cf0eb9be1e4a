"""The driver's view of the nodes: expected, alive and lost ones."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, NamedTuple

import zenoh

from mast_zenoh.messagelog.churn import BACK, LOST
from mast_zenoh.runtime.mesh.inbox import Event
from mast_zenoh.runtime.mesh.newest import NewestByNode

#: Maximum number of losses of a node that comes back; more often, the run ends.
MAX_LOSSES = 50


class Presence(NamedTuple):
    """A liveliness token: whether it disappeared since the last look, and exists now."""

    gone: bool
    present: bool

    def followed_by(self, newer: Presence) -> Presence:
        """This change and a newer one combined."""
        return Presence(self.gone or newer.gone, newer.present)

    def remaining(self) -> Presence | None:
        """A node's return, which the driver handles after its loss, as a separate event."""
        return Presence(False, True) if self.gone and self.present else None


class Membership:
    """Participating nodes, from the scenario, wiring changes and liveliness tokens.

    own:      the driver's name;  put: adds an event to the inbox
    expected: name to role of all nodes that may take part
    alive:    nodes with a liveliness token
    leaving:  nodes that the scenario ends
    churn:    losses and returns of nodes, see messagelog.churn
    """

    def __init__(self, own: str, expected: dict[str, str], put: Callable[[Event], None]) -> None:
        self.own = own
        self.expected = expected
        self.alive: set[str] = {own}
        self.leaving: set[str] = set()
        self.churn: list[dict[str, Any]] = []
        self._presence = NewestByNode("alive", put, Presence.followed_by, Presence.remaining)

    @property
    def present(self) -> dict[str, str]:
        """Name to role of the expected nodes that are alive."""
        return {name: role for name, role in self.expected.items() if name in self.alive}

    def differs(self, members: dict[str, str]) -> bool:
        """Whether `members` differ from the expected nodes that are alive."""
        return (self.alive & self.expected.keys()) != members.keys()

    def on_token(self, token: zenoh.Sample) -> None:
        """Note a change of a node's token, in Zenoh's thread, for the main thread."""
        present = token.kind == zenoh.SampleKind.PUT
        self._presence.note(str(token.key_expr).rpartition("/")[2], Presence(not present, present))

    def take(self, name: str, frame: int, members: Collection[str]) -> str:
        """Take the change of a node that an event has announced; returns as `note` does.

        For a node that was lost and is back, this is the loss: another event announces the return, so that a new epoch
        can begin between the two.
        """
        presence = self._presence.take(name)
        return self.note(name, presence.present and not presence.gone, frame, members)

    def note(self, name: str, present: bool, frame: int, members: Collection[str]) -> str:
        """Note that a node has appeared or gone; returns why the run must end, or "".

        members: of the current epoch, those that have taken part
        """
        events = [each["what"] for each in self.churn if each["node"] == name]
        lost = events[-1:] == [LOST]
        if present or name == self.own:  # the driver's own token may come late
            self.alive.add(name)
            self.leaving.discard(name)
            if lost:
                self.churn.append({"frame": frame, "node": name, "what": BACK})
            return ""
        self.alive.discard(name)
        if name in members and name in self.expected and name not in self.leaving:
            if lost:  # it was back too briefly for the driver to notice
                self.churn.append({"frame": frame, "node": name, "what": BACK})
            self.churn.append({"frame": frame, "node": name, "what": LOST})
            if sum(each["node"] == name for each in self.churn) > 2 * MAX_LOSSES:
                return f"{name} was lost and came back more than {MAX_LOSSES} times"
        return ""
