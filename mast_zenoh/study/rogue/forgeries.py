"""What a compromised node sends on the control keys of its run. Pure: a position and a seed in, messages out."""

from __future__ import annotations

from typing import NamedTuple

from mast_zenoh import streams
from mast_zenoh.control import CONTROLS
from mast_zenoh.study.rogue.falsehoods import falsehoods, sound
from mast_zenoh.study.rogue.malformed import flipped, heavy, malformed, pack
from mast_zenoh.study.rogue.position import Position

#: Kinds that are asked by a query; all others are published.
QUERIES = frozenset({"result", "fetch", "file", "drain", "rewire", "intercept"})

#: How a forgery was made: malformed ones no decoder takes, false ones are well formed, damaged ones may be either.
MALFORMED, DAMAGED, FALSE = "malformed", "damaged", "false"

#: From so many forgeries of a kind on, some are heavy.
_WITH_HEAVY = 100

#: The share of forgeries that goes to keys of other nodes, where the kind has a key for each.
_FOREIGN = 0.2


class Forgery(NamedTuple):
    """One forged control message.

    control: its kind, of CONTROLS
    key:     below @control/
    made:    MALFORMED, DAMAGED or FALSE
    """

    control: str
    key: str
    payload: bytes
    made: str

    @property
    def own(self) -> str:
        """The node in whose name it is sent; "" for a key of nobody's own."""
        return self.key.partition("/")[2]


def forgeries(control: str, position: Position, count: int, seed: int = 0) -> list[Forgery]:
    """So many messages of one kind: a third of them malformed, a third damaged, a third false.

    Most go to the node's own key, where the kind has a key for each node.
    """
    random = streams.stream(seed, "forgeries", position.node, control)
    value, false = sound(control, position), falsehoods(control, position)
    first = int(random.integers(len(false)))
    own, *foreign = keys(control, position)
    made = [Forgery(control, own, each, MALFORMED) for each in (heavy(value, control) if count >= _WITH_HEAVY else ())]
    while len(made) < count:
        kind = (MALFORMED, DAMAGED, FALSE)[len(made) % 3]
        key = foreign[int(random.integers(len(foreign)))] if foreign and random.random() < _FOREIGN else own
        if kind == MALFORMED:
            payload = malformed(value, random)
        elif kind == DAMAGED:
            payload = flipped(value, random)
        else:
            payload = pack(false[(first + len(made) // 3) % len(false)])
        made.append(Forgery(control, key, payload, kind))
    return made[:count]


def keys(control: str, position: Position) -> list[str]:
    """The keys of a kind below @control/, the node's own first, where the kind has one for each node."""
    if CONTROLS[control].own or control in ("leave", "drain"):
        return [f"{control}/{name}" for name in (position.node, *position.others)]
    return [control]


def everything(position: Position, count: int, seed: int = 0) -> list[Forgery]:
    """So many of every kind."""
    return [each for control in CONTROLS for each in forgeries(control, position, count, seed)]
