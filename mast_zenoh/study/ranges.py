"""Ranges of possible metric values, to which intervals are clipped."""

from __future__ import annotations

import math

from mast_zenoh.metrics import CAUSES
from mast_zenoh.metrics.study_results import Series
from mast_zenoh.study.numbers import ACHIEVED, DEFENCE, DRIVING

#: Scores that are lengths or counts; user-defined metrics may have any range.
_NOT_NEGATIVE = frozenset({"fn", "fp", "tp", "rmse_m", "id_switches", "ospa_m", "gospa_m"})
_SPLITS = ("fn_split.", "fp_split.", "id_switches_split.")
_DIFFERENCES = ("_iob", "_ioe")


def value_range(series: Series) -> tuple[float, float]:
    """(smallest, largest) possible value of a series; infinite where unknown.

    Counts, lengths and times are at least 0, shares are 0 to 1, differences can have either sign.
    """
    metric = series.metric
    if metric.endswith(_DIFFERENCES):
        return -math.inf, math.inf
    if series.estimator == DEFENCE:
        return 0.0, math.inf
    if series.estimator == ACHIEVED or metric.startswith(f"{DRIVING}."):
        share = "share" in metric or metric.endswith("_seen_by_others")
        return 0.0, 1.0 if share else math.inf
    if metric in ("completeness", "precision", "recall", "samota"):
        return 0.0, 1.0
    is_cause_count = metric.partition(" ")[2] in CAUSES
    return (0.0 if metric in _NOT_NEGATIVE or metric.startswith(_SPLITS) or is_cause_count else -math.inf), math.inf
