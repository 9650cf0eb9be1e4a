"""Means with their spread: over the frames of all trials, and over trials with a bootstrap interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mast_zenoh.states import Floats
from mast_zenoh.streams import stream

CONFIDENCE = 0.95
RESAMPLES = 9_999


class Moments(NamedTuple):
    """Of the values of one trial's frames: their number, mean and standard deviation (divided by the number)."""

    n: int
    mean: float
    std: float


def pooled(parts: Sequence[Moments]) -> tuple[float, float]:
    """Mean and standard deviation of all frames of all trials together; NaN without any."""
    n = np.array([part.n for part in parts], np.float64)
    if n.sum() == 0.0:
        return float("nan"), float("nan")
    mean, std = np.array([part.mean for part in parts]), np.array([part.std for part in parts])
    middle = float(np.average(mean, weights=n))
    return middle, float(np.sqrt(np.average(std**2 + (mean - middle) ** 2, weights=n)))


def interval(values: Floats, seed: int, *purpose: str) -> tuple[float, float]:
    """95 % interval of the mean of (n,) trials: bias-corrected and accelerated bootstrap, resampling trials.

    The draws are those of the stream (seed, "bootstrap", purpose). NaN of fewer than two values; of equal ones, they.
    """
    from scipy.stats import bootstrap  # slow to load, and workers have no use for it

    values = np.asarray(values, np.float64)
    if len(values) < 2:
        return float("nan"), float("nan")
    if np.ptp(values) == 0.0:
        return float(values[0]), float(values[0])
    rng = stream(seed, "bootstrap", *purpose)
    found = bootstrap(
        (values,), np.mean, n_resamples=RESAMPLES, confidence_level=CONFIDENCE, method="BCa", batch=1000, rng=rng
    ).confidence_interval
    return float(found.low), float(found.high)
