"""The driver's view of which nodes are expected, which are there, and which were lost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import zenoh

from mast_zenoh.messagelog.churn import BACK, LOST
from mast_zenoh.runtime.mesh.inbox import Event
from mast_zenoh.runtime.mesh.newest import NewestByNode

#: How often a node may be lost and come back; one that does so more often is not sound.
MAX_LOSSES = 50


class Presence(NamedTuple):
    """A node's liveliness token: whether it has gone since the driver looked last, and whether it is there now."""

    gone: bool
    there: bool

    def followed_by(self, newer: Presence) -> Presence:
        """Both in one, if the driver looks only now."""
        return Presence(self.gone or newer.gone, newer.there)

    def rest(self) -> Presence | None:
        """That a node is back, which the driver takes after, and apart from, that it has gone."""
        return Presence(False, True) if self.gone and self.there else None


class Membership:
    """Which nodes take part, from what the scenario, changes of the wiring and the liveliness tokens say.

    own:      the driver's name;  put: adds an event to the inbox
    expected: name to role of all nodes that may take part
    alive:    those that are there
    leaving:  those whose end the scenario wants
    churn:    who was lost and came back, see messagelog.churn
    """

    def __init__(self, own: str, expected: dict[str, str], put: Callable[[Event], None]) -> None:
        self.own = own
        self.expected = expected
        self.alive: set[str] = {own}
        self.leaving: set[str] = set()
        self.churn: list[dict[str, Any]] = []
        self._presence = NewestByNode("alive", put, Presence.followed_by, Presence.rest)

    @property
    def present(self) -> dict[str, str]:
        """Name to role of the expected nodes that are there."""
        return {name: role for name, role in self.expected.items() if name in self.alive}

    def differs(self, members: dict[str, str]) -> bool:
        """Whether these are others than the nodes that are expected and there."""
        return (self.alive & self.expected.keys()) != members.keys()

    def on_token(self, token: zenoh.Sample) -> None:
        """A node's token has come or gone, in Zenoh's thread; an event announces it to the main thread."""
        there = token.kind == zenoh.SampleKind.PUT
        self._presence.note(str(token.key_expr).rpartition("/")[2], Presence(not there, there))

    def take(self, name: str, frame: int, members: dict[str, str]) -> str:
        """Take what an event has announced of a node; see `note`.

        If it has gone and is back, it has gone here: a further event says that it is back, so that a new epoch can
        begin between the two.
        """
        presence = self._presence.take(name)
        return self.note(name, presence.there and not presence.gone, frame, members)

    def note(self, name: str, there: bool, frame: int, members: dict[str, str]) -> str:
        """A node has come or gone; members: of the current epoch. Returns why the run cannot go on, or ""."""
        if there or name == self.own:  # the driver's own token may come late
            self.alive.add(name)
            self.leaving.discard(name)
            before = [each["what"] for each in self.churn if each["node"] == name]
            if before and before[-1] == LOST:
                self.churn.append({"frame": frame, "node": name, "what": BACK})
            return ""
        self.alive.discard(name)
        if name in members and name in self.expected and name not in self.leaving:
            self.churn.append({"frame": frame, "node": name, "what": LOST})
            if sum(each["node"] == name for each in self.churn) > 2 * MAX_LOSSES:
                return f"{name} has gone and come back more than {MAX_LOSSES} times"
        return ""
