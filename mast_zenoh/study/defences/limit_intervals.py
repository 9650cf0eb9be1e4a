"""Intervals for the studies of limits: of a share, and of any statistic by resampling trials. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from scipy.special import betaincinv

from mast_zenoh.report.limit_rows import Measured

_TAIL = 0.025
RESAMPLES = 1000

Unit = TypeVar("Unit")


def share(successes: int, total: int) -> Measured:
    """A share of independent trials, with the 95 % interval of Clopper and Pearson (1934); NaN without trials."""
    if not total:
        return Measured()
    low = float(betaincinv(successes, total - successes + 1, _TAIL)) if successes else 0.0
    high = float(betaincinv(successes + 1, total - successes, 1.0 - _TAIL)) if successes < total else 1.0
    return Measured(successes / total, low, high)


def bootstrap(
    units: Sequence[Unit], statistic: Callable[[Sequence[Unit]], float], random: np.random.Generator
) -> Measured:
    """A statistic of independent units, with the 95 % percentile interval of RESAMPLES resamples.

    statistic: infinite if it is beyond what was watched; NaN if it is unknown. Resamples in which it is unknown are
    left out. Without at least two units there is no interval.
    """
    value = statistic(units)
    if len(units) < 2 or math.isnan(value):
        return Measured(value)
    draws = random.integers(len(units), size=(RESAMPLES, len(units)))
    values = np.array([statistic([units[index] for index in draw]) for draw in draws.tolist()])
    values = np.sort(values[~np.isnan(values)])
    if not len(values):
        return Measured(value)
    low, high = (values[round(q * (len(values) - 1))] for q in (_TAIL, 1.0 - _TAIL))
    return Measured(value, float(low), float(high))
