"""Identifies the original of a damaged message."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mast_zenoh.wiring.received import Overheard

#: Identifies a message of a wire's publisher: frame and sequence number.
Id = tuple[int, int]

#: Fraction of equal bytes from which one message counts as a damaged copy of another.
SIMILAR = 0.9
#: Number of recent messages to compare with a damaged one.
COMPARED = 32


def find_original(waiting: Mapping[Id, Sequence[Overheard]], damaged: Overheard) -> Id | None:
    """The original of a damaged message.

    The most similar of the newest unsent messages before it.

    waiting: by number, the messages that have not been sent on yet, the newest last
    """
    candidates = [(id_, messages[0]) for id_, messages in waiting.items() if messages[0].step <= damaged.step]
    similarities = [
        (_similarity(message.payload, damaged.payload), index)
        for index, (_, message) in enumerate(candidates[-COMPARED:])
    ]
    similarity, index = max(similarities, default=(0.0, 0))
    return candidates[-COMPARED:][index][0] if similarity >= SIMILAR else None


def _similarity(a: bytes, b: bytes) -> float:
    """Number of equal bytes divided by the length of the longer one."""
    longer, shorter = max(len(a), len(b)), min(len(a), len(b))
    if shorter < SIMILAR * longer:
        return 0.0
    equal = np.frombuffer(a, np.uint8, shorter) == np.frombuffer(b, np.uint8, shorter)
    return float(np.count_nonzero(equal)) / longer if longer else 1.0
