"""Counts of errors by cause, per estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Ints
from mast_zenoh.metrics.causes import CAUSES, PARTS, UNKNOWN
from mast_zenoh.metrics.scores import Scores


def causes_of(scores: Scores, cause: Ints, switch_cause: Ints, frames: Ints) -> list[dict[str, Any]]:
    """Counts of errors by cause for each row of `scores.series` in these frames.

    cause, switch_cause: of `scores.judged` and `scores.switches`, as returned by `Attributor.labels`

    Returns {"causes": {"fp" | "fn" | "id_switches": {cause: number of rows}}, "fn_split" | "fp_split": {"fault",
    "attack", "withheld", "natural"}, objects per frame, "id_switches_split": the same, switches of the whole run}.
    """
    n = len(scores.series)
    rows = np.flatnonzero(cause != UNKNOWN)
    rows = rows[np.isin(scores.judged.frame[rows], frames)]
    track, series = scores.judged.is_track[rows], scores.judged.series[rows]
    switched = np.isin(scores.frames[scores.switches.frame], frames)
    counts = {
        "fp": _count_causes(series[track], cause[rows[track]], n),
        "fn": _count_causes(series[~track], cause[rows[~track]], n),
        "id_switches": _count_causes(scores.switches.series[switched], switch_cause[switched], n),
    }
    totals = {"fn": len(frames), "fp": len(frames), "id_switches": 1}
    return [
        {"causes": {error: {name: m for name, m in table[k].items() if m} for error, table in counts.items()}}
        | {f"{error}_split": split(counts[error][k], total) for error, total in totals.items()}
        for k in range(n)
    ]


def _count_causes(series: Ints, cause: Ints, n: int) -> list[dict[str, int]]:
    """Number of rows with each cause, for each of n series."""
    table = np.bincount(series * len(CAUSES) + cause, minlength=n * len(CAUSES)).reshape(n, len(CAUSES))
    return [dict(zip(CAUSES, row, strict=True)) for row in table.tolist()]


def split(counts: Mapping[str, int], frames: int) -> dict[str, float | None]:
    """Mean number of rows per frame, by {"fault", "attack", "withheld", "natural"}.

    None without frames.
    counts: rows by cause
    """
    rows = {part: sum(counts.get(cause, 0) for cause in causes) for part, causes in PARTS.items()}
    rows["natural"] = sum(counts.values()) - sum(rows.values())
    return {name: number / frames if frames else None for name, number in rows.items()}
