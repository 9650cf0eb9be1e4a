"""Times until detection; runs that end before it are censored, not left out. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mast_zenoh.metrics.study_results import Survival


def kaplan_meier(time_s: ArrayLike, detected: ArrayLike) -> Survival:
    """The survival curve of n times.

    time_s: (n,) s until detection, or for which it was watched in vain;  detected: (n,) bool
    A time at which one is detected and another censored counts both as watched. Raises ValueError for negative times.
    """
    times, events = np.asarray(time_s, np.float64).ravel(), np.asarray(detected, bool).ravel()
    if len(times) != len(events):
        raise ValueError(f"detected: found {len(events)}, expected {len(times)}, one for each time")
    if not (times >= 0.0).all():
        raise ValueError("time_s: found a negative time or NaN, expected 0 or more")
    at = np.unique(times[events])
    watched = (times[None, :] >= at[:, None]).sum(axis=1)
    now = (times[events][None, :] == at[:, None]).sum(axis=1)
    share = np.cumprod(1.0 - now / np.maximum(watched, 1))
    curve_times, curve = np.concatenate([[0.0], at]), np.concatenate([[1.0], share])
    last = float(times.max(initial=0.0))
    if last > curve_times[-1]:
        curve_times, curve = np.append(curve_times, last), np.append(curve, curve[-1])
    return Survival(curve_times, curve, int(events.sum()), len(times))
