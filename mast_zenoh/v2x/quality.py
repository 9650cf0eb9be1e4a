"""Perception quality of objects, as messages of Collective Perception carry it: 0 to 15.

There is no probability of existence in these messages; receivers see this number instead.
"""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints

MAX_QUALITY = 15  #: of objectPerceptionQuality (TS 102 894-2 v2.2.1)


def quality_of_score(score: Floats) -> Ints:
    """(n,) quality, 0 to 15, of scores (n,) in [0, 1]."""
    return np.rint(np.clip(score, 0.0, 1.0) * MAX_QUALITY).astype(np.int64)
