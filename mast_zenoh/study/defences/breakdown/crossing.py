"""The share of liars at which a curve first reaches one half. Pure."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

#: Half of the trials, and half of the objects.
HALF = 0.5
_ROUNDING = 1e-12


def crossing(x: ArrayLike, y: ArrayLike) -> float:
    """The smallest x at which y reaches one half, by linear interpolation; infinite if it never does.

    x: (n,) ascending;  y: (n,)

    A breakdown point is the smallest share that breaks a defence, so a later fall of y changes nothing. With few trials
    a chance peak makes it smaller, which is the safe side. If y is one half or more from the first x on, that is the
    answer. Raises ValueError for no points.
    """
    at, share = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if not len(at):
        raise ValueError("x: found no points, expected one or more")
    reached = share >= HALF - _ROUNDING
    if not reached.any():
        return math.inf
    after = int(reached.argmax())
    if after == 0:
        return float(at[0])
    before = after - 1
    fraction = min(1.0, (HALF - share[before]) / (share[after] - share[before]))
    return float(at[before] + fraction * (at[after] - at[before]))
