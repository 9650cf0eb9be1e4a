"""The displaced objects of one run: who could see them, how far they were off, and when the liar was suspended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mast_zenoh.api.observability import observability
from mast_zenoh.api.runs import Run
from mast_zenoh.launch.tables import from_arrow


def evaluate(folder: Path, metrics: Mapping[str, Any], compromised: Sequence[str]) -> dict[str, Any]:
    """The part `defence` of a trial's metrics, from its run folder.

    compromised: names of the agents with an adversary, not needed here

    The result:
    first_lie_s, suspended_s: s of scene time, of the only liar; None: never
    end_s:    s, the last frame
    displaced: columns of a row for each displaced track and frame: time_s, track, viewers (honest agents that see the
              real object), offset_m (in the plane)
    """
    run = Run(folder)
    lies = from_arrow(observability(run).lies)
    moved = np.flatnonzero(np.isin(lies["effect"], ("moved", "altered")))
    offset = _offsets(run)
    keys = zip(lies["frame"][moved].tolist(), lies["id"][moved].tolist(), strict=True)
    liars = [each for each in metrics["integrity"]["agents"].values() if each["lied"]]
    first, delay = (liars[0]["first_lie_s"], liars[0]["suspended_after_s"]) if liars else (None, None)
    return {
        "first_lie_s": first,
        "suspended_s": None if delay is None else round(first + delay, 9),
        "end_s": _end_s(run),
        "displaced": {
            "time_s": lies["time_s"][moved].tolist(),
            "track": lies["id"][moved].tolist(),
            "viewers": lies["honest_viewers"][moved].tolist(),
            "offset_m": [round(offset.get(key, 0.0), 6) for key in keys],
        },
    }


def _offsets(run: Run) -> dict[tuple[int, int], float]:
    """m in the plane by which a track was moved, by frame and id."""
    table = from_arrow(run.attacks)
    rows = np.flatnonzero(np.isin(table["effect"], ("moved", "altered")) & (table["role"] != "link"))
    shift = np.hypot(*(table[f"after_{axis}"][rows] - table[f"before_{axis}"][rows] for axis in "xy"))
    keys = zip(table["frame"][rows].tolist(), table["id"][rows].tolist(), strict=True)
    return dict(zip(keys, np.nan_to_num(shift).tolist(), strict=True))


def _end_s(run: Run) -> float:
    return float(from_arrow(run.trust)["time_s"].max())
