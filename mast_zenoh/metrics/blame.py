"""Counts of errors by cause, per estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Ints
from mast_zenoh.metrics.causes import ATTACK_CAUSES, CAUSES, FAULT_CAUSES, UNKNOWN
from mast_zenoh.metrics.scores import Scores


def causes_of(scores: Scores, cause: Ints, switch_cause: Ints, frames: Ints) -> list[dict[str, Any]]:
    """Of each row of `scores.series` what its errors in these frames are due to.

    cause, switch_cause: of `scores.judged` and `scores.switches`, as `Attribution.label` returns them

    {"causes": {"fp" | "fn" | "id_switches": {cause: number of rows}}, "fn_split" | "fp_split": {"fault", "attack",
    "natural"}, objects per frame, "id_switches_split": the same, switches of the whole run}; causes that occur only.
    """
    n = len(scores.series)
    rows = np.flatnonzero(cause != UNKNOWN)
    rows = rows[np.isin(scores.judged.frame[rows], frames)]
    track, series = scores.judged.is_track[rows], scores.judged.series[rows]
    switched = np.isin(scores.frames[scores.switches.frame], frames)
    counts = {
        "fp": _counted(series[track], cause[rows[track]], n),
        "fn": _counted(series[~track], cause[rows[~track]], n),
        "id_switches": _counted(scores.switches.series[switched], switch_cause[switched], n),
    }
    totals = {"fn": len(frames), "fp": len(frames), "id_switches": 1}
    return [
        {"causes": {what: {name: m for name, m in table[k].items() if m} for what, table in counts.items()}}
        | {f"{what}_split": split(counts[what][k], total) for what, total in totals.items()}
        for k in range(n)
    ]


def _counted(series: Ints, cause: Ints, n: int) -> list[dict[str, int]]:
    """Of each of n series how many rows have each cause."""
    table = np.bincount(series * len(CAUSES) + cause, minlength=n * len(CAUSES)).reshape(n, len(CAUSES))
    return [dict(zip(CAUSES, row, strict=True)) for row in table.tolist()]


def split(counts: Mapping[str, int], frames: int) -> dict[str, float | None]:
    """{"fault", "attack", "natural"}: rows per frame, mean over `frames`; None without a frame.

    counts: rows by cause
    """
    rows = {"fault": sum(counts.get(cause, 0) for cause in FAULT_CAUSES)}
    rows["attack"] = sum(counts.get(cause, 0) for cause in ATTACK_CAUSES)
    rows["natural"] = sum(counts.values()) - sum(rows.values())
    return {name: number / frames if frames else None for name, number in rows.items()}
