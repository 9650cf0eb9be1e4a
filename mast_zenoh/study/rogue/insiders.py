"""Attacks by a compromised node with its own certificate and key.

A scenario file's `insiders()` lists them as dicts: dict(type="ForgeControls", name="agent", node="infra_1", …).
The file may define its own subclasses of Insider.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import zenoh

from mast_zenoh import streams
from mast_zenoh.study.rogue.attacked_run import AttackedRun
from mast_zenoh.study.rogue.forgeries import FALSE, MALFORMED, Forgery, all_forgeries
from mast_zenoh.study.rogue.position import Position
from mast_zenoh.study.rogue.sending import send


class Insider(ABC):
    """Base class of insiders: a second session with the credentials of a node.

    The node itself is unchanged.

    name: its name in the table
    node: the node whose certificate and key it has
    """

    def __init__(self, name: str, node: str) -> None:
        self.name = name
        self.node = node

    @abstractmethod
    def act(self, attacked_run: AttackedRun, session: zenoh.Session, position: Position) -> int:
        """Attack the run while it plays; returns the number of messages sent."""


class ForgeControls(Insider):
    """Send forged control messages.

    own:      true: false messages in the node's own name; false: messages in the names of other nodes, the driver and
              the launcher, and malformed ones in its own name
    messages: their number; seed: selects them
    """

    def __init__(self, name: str, node: str, own: bool = False, messages: int = 30, seed: int = 0) -> None:
        super().__init__(name, node)
        self.own = own
        self.messages = messages
        self.seed = seed

    def select_messages(self, position: Position) -> list[Forgery]:
        """The messages to send: kinds take turns, in random order within each kind."""
        candidates = [each for each in all_forgeries(position, self.messages, self.seed) if self._is_selected(each)]
        order = streams.stream(self.seed, "order", position.node).permutation(len(candidates))
        by_control: dict[str, list[Forgery]] = {}
        for index in order:
            by_control.setdefault(candidates[index].control, []).append(candidates[index])
        rounds = (
            forgeries[round_index]
            for round_index in range(self.messages)
            for forgeries in by_control.values()
            if round_index < len(forgeries)
        )
        return [each for each, _ in zip(rounds, range(self.messages), strict=False)]

    def act(self, attacked_run: AttackedRun, session: zenoh.Session, position: Position) -> int:
        return send(session, attacked_run.prefix, self.select_messages(position))

    def _is_selected(self, forgery: Forgery) -> bool:
        in_own_name = forgery.sender == self.node
        if self.own:
            return in_own_name and forgery.defect == FALSE and forgery.control not in ("leave", "drain")
        return not in_own_name or forgery.defect == MALFORMED
