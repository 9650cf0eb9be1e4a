"""Where honest viewers outnumber malicious ones: the bound of what a majority can identify. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mast_zenoh.study.defences.placement import MIN_RETURNS


def honest_majority(points: ArrayLike, malicious: ArrayLike) -> float:
    """Share of objects that more honest agents see than malicious ones, of those that any agent sees; NaN: none.

    points:    (n, a) lidar returns of n objects, over all frames, at a agents
    malicious: (a,) bool
    """
    sees = np.asarray(points) >= MIN_RETURNS
    lying = np.asarray(malicious, bool)
    seen = sees[sees.any(axis=1)]
    if not len(seen):
        return float("nan")
    return float((seen[:, ~lying].sum(axis=1) > seen[:, lying].sum(axis=1)).mean())
