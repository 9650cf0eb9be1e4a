"""What a compromised node can try against its run, with its own certificate and key.

A scenario file's `insiders()` lists them as dicts: dict(type="ForgeControls", name="agent", node="infra_1", …).
Subclasses of Insider in that file can be named as well.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import zenoh

from mast_zenoh import streams
from mast_zenoh.study.rogue.forgeries import FALSE, MALFORMED, Forgery, everything
from mast_zenoh.study.rogue.position import Position
from mast_zenoh.study.rogue.sending import send
from mast_zenoh.study.rogue.siege import Siege


class Insider(ABC):
    """Base of all insiders. It is a second session with a node's credentials; the node itself stays sound.

    name: what the table calls it
    node: whose certificate and key it has
    """

    def __init__(self, name: str, node: str) -> None:
        self.name = name
        self.node = node

    @abstractmethod
    def act(self, siege: Siege, session: zenoh.Session, position: Position) -> int:
        """Try it, while the run goes on; how many messages were sent. What comes of it is measured from the run."""


class ForgeControls(Insider):
    """Send forged control messages.

    own:      in the node's own name, and false; otherwise in the names of others and of the driver and the launcher,
              and malformed ones in its own
    messages: how many; seed: which
    """

    def __init__(self, name: str, node: str, own: bool = False, messages: int = 30, seed: int = 0) -> None:
        super().__init__(name, node)
        self.own = own
        self.messages = messages
        self.seed = seed

    def chosen(self, position: Position) -> list[Forgery]:
        """The messages, of all kinds alike, in an order drawn at random."""
        made = [each for each in everything(position, self.messages, self.seed) if self._fits(each)]
        order = streams.stream(self.seed, "order", position.node).permutation(len(made))
        kinds: dict[str, list[Forgery]] = {}
        for at in order:
            kinds.setdefault(made[at].control, []).append(made[at])
        rounds = (kind[turn] for turn in range(self.messages) for kind in kinds.values() if turn < len(kind))
        return [each for each, _ in zip(rounds, range(self.messages), strict=False)]

    def act(self, siege: Siege, session: zenoh.Session, position: Position) -> int:
        """See Insider."""
        return send(session, siege.prefix, self.chosen(position))

    def _fits(self, each: Forgery) -> bool:
        in_own_name = each.own == self.node
        if self.own:
            return in_own_name and each.made == FALSE and each.control not in ("leave", "drain")
        return not in_own_name or each.made == MALFORMED
