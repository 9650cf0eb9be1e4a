"""The driver's view of the nodes: expected, alive and lost ones."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NamedTuple

from mast_zenoh.messagelog.churn import BACK, LOST

#: Maximum number of losses of a node that comes back; more often, the run ends.
MAX_LOSSES = 50


class Presence(NamedTuple):
    """A liveliness token: whether it disappeared since the last look, and exists now."""

    gone: bool
    present: bool

    def followed_by(self, newer: Presence) -> Presence:
        """This change and a newer one combined."""
        return Presence(self.gone or newer.gone, newer.present)


class Membership:
    """Participating nodes, from the scenario, wiring changes and liveliness tokens.

    own:      the driver's name
    expected: name to role of all nodes that may take part
    alive:    nodes with a liveliness token
    replaced: nodes whose token went since the epoch began: their new process joins in an epoch of its own
    leaving:  nodes that the scenario ends
    churn:    losses and returns of nodes, see messagelog.churn
    """

    def __init__(self, own: str, expected: dict[str, str]) -> None:
        self.own = own
        self.expected = expected
        self.alive: set[str] = {own}
        self.replaced: set[str] = set()
        self.leaving: set[str] = set()
        self.churn: list[dict[str, Any]] = []

    @property
    def present(self) -> dict[str, str]:
        """Name to role of the expected nodes that are alive, except replaced ones."""
        return {name: role for name, role in self.expected.items() if name in self.alive - self.replaced}

    def differs(self, members: dict[str, str]) -> bool:
        """Whether `members` differ from the present nodes."""
        return bool(self.replaced) or (self.alive & self.expected.keys()) != members.keys()

    def note(self, name: str, presence: Presence, frame: int, members: Collection[str]) -> str:
        """Note that a node has gone, has appeared, or both; returns why the run must end, or "".

        members: of the current epoch, those that have taken part
        """
        if name == self.own:  # the driver's own token may come late
            return ""
        problem = self._lose(name, frame, members) if presence.gone else ""
        if presence.present:
            self.alive.add(name)
            self.leaving.discard(name)
            if self._was_lost(name):
                self.churn.append({"frame": frame, "node": name, "what": BACK})
        return problem

    def begin_epoch(self) -> dict[str, str]:
        """The members of a new epoch; returned nodes may join the next one."""
        members = self.present
        self.replaced.clear()
        return members

    def _lose(self, name: str, frame: int, members: Collection[str]) -> str:
        self.alive.discard(name)
        self.replaced.add(name)
        if name not in members or name not in self.expected or name in self.leaving:
            return ""
        if self._was_lost(name):  # it was back too briefly for the driver to notice
            self.churn.append({"frame": frame, "node": name, "what": BACK})
        self.churn.append({"frame": frame, "node": name, "what": LOST})
        lost_too_often = sum(event["node"] == name for event in self.churn) > 2 * MAX_LOSSES
        return f"{name} was lost and came back more than {MAX_LOSSES} times" if lost_too_often else ""

    def _was_lost(self, name: str) -> bool:
        events = [event["what"] for event in self.churn if event["node"] == name]
        return events[-1:] == [LOST]
