"""What values a metric can have at all: no interval says that a count may be negative, or a share above 1."""

from __future__ import annotations

import math

from mast_zenoh.metrics import CAUSES
from mast_zenoh.report.tables.study_rows import Series
from mast_zenoh.study.numbers import ACHIEVED, DRIVING

#: Of what every estimate scores, lengths and counts; user-defined metrics can be anything.
_NOT_NEGATIVE = frozenset({"fn", "fp", "tp", "rmse_m", "id_switches", "ospa_m", "gospa_m"})
_SPLITS = ("fn_split.", "fp_split.", "id_switches_split.")
_DIFFERENCES = ("_iob", "_ioe")


def possible(series: Series) -> tuple[float, float]:
    """Least and greatest value that a series can have; infinite where there is none, or none is known.

    Counts, lengths and times are 0 or more, shares are 0 to 1. Differences can have either sign.
    """
    metric = series.metric
    if metric.endswith(_DIFFERENCES):
        return -math.inf, math.inf
    if series.estimator == ACHIEVED or metric.startswith(f"{DRIVING}."):
        share = "share" in metric or metric.endswith("_seen_by_others")
        return 0.0, 1.0 if share else math.inf
    if metric == "completeness":
        return 0.0, 1.0
    of_cause = metric.partition(" ")[2] in CAUSES
    return (0.0 if metric in _NOT_NEGATIVE or metric.startswith(_SPLITS) or of_cause else -math.inf), math.inf
