"""Named random streams, the source of every random number in a run.

A stream is derived from (seed, names...) alone. Two scenarios with the same seed therefore have the same scene,
detections and clutter, and adding an adversary does not affect other draws (common random numbers).
"""

from __future__ import annotations

import hashlib

import numpy as np


def stream(seed: int, *names: str | int) -> np.random.Generator:
    """The random generator with a name: `stream(seed, "adversary_1", "selection", 3)`.

    Equal arguments give equal draws on every machine; any difference gives an independent stream.
    """
    digest = hashlib.blake2b("\x1f".join([str(seed), *map(str, names)]).encode(), digest_size=16).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest, "little")))
