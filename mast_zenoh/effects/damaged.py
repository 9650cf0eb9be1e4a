"""Which message a damaged one was. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mast_zenoh.wiring.received import Overheard

#: What identifies a message among those of its wire's publisher: frame and sequence number.
Id = tuple[int, int]

#: Part of the bytes of two messages that must be equal for one to be taken for a damaged copy of the other.
SIMILAR = 0.9
#: Messages with which a damaged one is compared.
COMPARED = 32


def resembled(waiting: Mapping[Id, Sequence[Overheard]], damaged: Overheard) -> Id | None:
    """The waiting message of which this is a damaged copy: the most similar of the newest ones that came before it.

    waiting: by number the messages that have not been sent on yet, the newest last
    """
    before = [(id_, messages[0]) for id_, messages in waiting.items() if messages[0].step <= damaged.step]
    shares = [(_similarity(each.payload, damaged.payload), place) for place, (_, each) in enumerate(before[-COMPARED:])]
    share, place = max(shares, default=(0.0, 0))
    return before[-COMPARED:][place][0] if share >= SIMILAR else None


def _similarity(a: bytes, b: bytes) -> float:
    """Share of the bytes of the longer one of two that are equal in both."""
    longer, shorter = max(len(a), len(b)), min(len(a), len(b))
    if shorter < SIMILAR * longer:
        return 0.0
    equal = np.frombuffer(a, np.uint8, shorter) == np.frombuffer(b, np.uint8, shorter)
    return float(np.count_nonzero(equal)) / longer if longer else 1.0
