"""Where honest viewers outnumber malicious ones: the bound of what a majority can identify. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import hypergeom

from mast_zenoh.study.defences.placement import MIN_RETURNS


def honest_majority(points: ArrayLike, malicious: ArrayLike, min_returns: int = MIN_RETURNS) -> float:
    """Share of objects that more honest agents see than malicious ones, of those that any agent sees; NaN: none.

    points:    (n, a) lidar returns of n objects, over all frames, at a agents
    malicious: (a,) bool
    """
    sees = np.asarray(points) >= min_returns
    lying = np.asarray(malicious, bool)
    seen = sees[sees.any(axis=1)]
    if not len(seen):
        return float("nan")
    return float((seen[:, ~lying].sum(axis=1) > seen[:, lying].sum(axis=1)).mean())


def expected_honest_majority(
    points: ArrayLike, count: int, eligible: ArrayLike | None = None, min_returns: int = MIN_RETURNS
) -> float:
    """Mean of `honest_majority` over all choices of `count` malicious agents, each equally likely.

    eligible: (a,) bool, agents that may be malicious; None: all
    Raises ValueError if fewer than `count` are eligible.
    """
    sees = np.asarray(points) >= min_returns
    can_lie = np.ones(sees.shape[1], bool) if eligible is None else np.asarray(eligible, bool)
    total = int(can_lie.sum())
    if not 0 <= count <= total:
        raise ValueError(f"count: found {count}, expected 0 to {total}, the number of eligible agents")
    seen = sees[sees.any(axis=1)]
    if not len(seen):
        return float("nan")
    # The number of liars among an object's eligible viewers is hypergeometric; honest viewers have the majority if
    # liars are fewer than half of all viewers.
    viewers, candidates = seen.sum(axis=1), seen[:, can_lie].sum(axis=1)
    most = (viewers - 1) // 2
    return float(hypergeom.cdf(most, total, candidates, count).mean())
