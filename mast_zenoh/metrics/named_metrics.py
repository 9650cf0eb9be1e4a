"""Metrics that a scenario can name, next to those that every run has."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.measures import FrameMetric, RunMetric
from mast_zenoh.metrics.scoring import Estimate


class ErrorsNearby(FrameMetric):
    """Missed objects and false tracks within a distance of the agent.

    distance_m: from the agent, in the bird's-eye view
    """

    unit = "objects"

    def __init__(self, *, distance_m: float = 30.0) -> None:
        if not distance_m > 0.0:
            raise ValueError(f"distance_m: found {distance_m}, expected more than 0")
        self.distance_m = distance_m

    def per_frame(self, estimate: Estimate) -> Floats:
        wrong = np.isin(estimate.outcome, ("missed", "false"))
        return estimate.count(wrong & (estimate.range_m <= self.distance_m))


class LongestMiss(RunMetric):
    """The longest uninterrupted time for which one object was missed, s."""

    unit = "s"

    def per_run(self, estimate: Estimate) -> float | None:
        rows = np.flatnonzero((estimate.outcome == "missed") & estimate.scored[estimate.frame])
        if not len(rows):
            return 0.0
        order = rows[np.lexsort((estimate.frame[rows], estimate.id[rows]))]
        breaks = (np.diff(estimate.id[order]) != 0) | (np.diff(estimate.frame[order]) != 1)
        lengths = np.diff(np.flatnonzero(np.concatenate([[True], breaks, [True]])))
        return float(lengths.max() * estimate.period_s)
