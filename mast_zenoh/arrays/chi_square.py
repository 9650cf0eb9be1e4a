"""Bounds of means of chi-square values, without SciPy, whose import takes longer than a short run."""

from __future__ import annotations

import math

#: Standard deviations of a normal distribution that contain 95 % of it.
TWO_SIDED = 1.959964


def mean_bounds(samples: float, dof: int) -> tuple[float, float]:
    """Two-sided 95 % bounds of the mean of independent chi-square values.

    samples: how many, need not be whole;  dof: their degrees of freedom, which is also the expected mean

    The cube-root approximation of Wilson and Hilferty (PNAS 1931): within 1 % from ten degrees of freedom in total.
    Without samples, the bounds are 0 and infinity.
    """
    if not samples > 0.0:
        return 0.0, math.inf
    spread = 2.0 / (9.0 * samples * dof)
    low, high = (dof * max(1.0 - spread + z * math.sqrt(spread), 0.0) ** 3 for z in (-TWO_SIDED, TWO_SIDED))
    return low, high
