"""Forged control messages; pure functions of a position and a seed."""

from __future__ import annotations

from typing import NamedTuple

from mast_zenoh import streams
from mast_zenoh.control import CONTROLS
from mast_zenoh.study.rogue.falsehoods import falsehoods
from mast_zenoh.study.rogue.malformed import flipped, heavy, malformed, pack
from mast_zenoh.study.rogue.position import Position
from mast_zenoh.study.rogue.valid_messages import valid_message

#: Kinds sent as queries; all others are published.
QUERIES = frozenset({"result", "fetch", "file", "drain", "rewire", "intercept"})

#: Defects: decoders reject malformed messages and accept false ones; damaged ones may be either.
MALFORMED, DAMAGED, FALSE = "malformed", "damaged", "false"

#: With at least this many forgeries of a kind, some are heavy.
_HEAVY_FROM = 100

#: Share of forgeries on keys of other nodes, for kinds with a key per node.
_FOREIGN = 0.2


class Forgery(NamedTuple):
    """One forged control message.

    control: its kind, of CONTROLS
    key:     below @control/
    defect:  MALFORMED, DAMAGED or FALSE
    """

    control: str
    key: str
    payload: bytes
    defect: str

    @property
    def sender(self) -> str:
        """The node that the key belongs to; "" for a shared key."""
        return self.key.partition("/")[2]


def forgeries(control: str, position: Position, count: int, seed: int = 0) -> list[Forgery]:
    """`count` messages of one kind: a third malformed, a third damaged, a third false.

    For kinds with a key per node, most go to the node's own key.
    """
    random = streams.stream(seed, "forgeries", position.node, control)
    valid, false_values = valid_message(control, position), falsehoods(control, position)
    offset = int(random.integers(len(false_values)))
    own_key, *foreign = keys(control, position)
    messages = [
        Forgery(control, own_key, each, MALFORMED) for each in (heavy(valid, control) if count >= _HEAVY_FROM else ())
    ]
    while len(messages) < count:
        defect = (MALFORMED, DAMAGED, FALSE)[len(messages) % 3]
        key = foreign[int(random.integers(len(foreign)))] if foreign and random.random() < _FOREIGN else own_key
        if defect == MALFORMED:
            payload = malformed(valid, random)
        elif defect == DAMAGED:
            payload = flipped(valid, random)
        else:
            payload = pack(false_values[(offset + len(messages) // 3) % len(false_values)])
        messages.append(Forgery(control, key, payload, defect))
    return messages[:count]


def keys(control: str, position: Position) -> list[str]:
    """The keys of a kind below @control/, the node's own first."""
    if CONTROLS[control].own or control in ("leave", "drain"):
        return [f"{control}/{name}" for name in (position.node, *position.others)]
    return [control]


def all_forgeries(position: Position, count: int, seed: int = 0) -> list[Forgery]:
    """`count` forgeries of every kind."""
    return [forgery for control in CONTROLS for forgery in forgeries(control, position, count, seed)]
