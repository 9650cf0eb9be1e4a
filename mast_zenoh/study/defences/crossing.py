"""The share of liars at which a rising curve passes a level. Pure."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import isotonic_regression

#: Half of the trials, and half of the objects.
HALF = 0.5


def crossing(x: ArrayLike, y: ArrayLike, weights: ArrayLike | None = None, level: float = HALF) -> float:
    """The x at which y reaches `level`, by linear interpolation; infinite if it never does.

    x: (n,) ascending;  y: (n,) shares that should not fall with x. Where they do, by chance, neighbours are averaged
    with their weights (isotonic regression) first. weights: (n,) numbers of trials, all above 0; None: equal.
    If y is at the level from the first x on, that is the answer. Raises ValueError for no points.
    """
    at, share = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if not len(at):
        raise ValueError("x: found no points, expected one or more")
    rising = isotonic_regression(share, weights=None if weights is None else np.asarray(weights, np.float64)).x
    reached = rising >= level - 1e-12
    if not reached.any():
        return math.inf
    after = int(reached.argmax())
    if after == 0:
        return float(at[0])
    before = after - 1
    fraction = (level - rising[before]) / (rising[after] - rising[before])
    return float(at[before] + fraction * (at[after] - at[before]))
