"""Errors added by an attack: increments over baseline (IoB) and ego (IoE).

IoE is over the ego's own tracks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.metrics.estimates import PICTURE
from mast_zenoh.metrics.scores import Table, mean_and_std

COUNTS = ("fn", "fp", "tp")


def increments(
    baseline: Table,
    attacked: Table,
    *,
    agent: str = "ego",
    compromised: Sequence[str] = (),
    estimator: str = PICTURE,
    alone: str = "local",
    first_frame: int | None = None,
) -> dict[str, Any]:
    """Increments of one attacked run as mean and standard deviation over frames.

    baseline, attacked: tables per frame (`measures.per_frame`) of two runs of the same scene and seed
    agent:              name of the agent
    compromised:        the agents whose wires were attacked
    estimator, alone:   the agent's estimator under attack, and its independent one
    first_frame:        earlier frames are left out; None: all are used, as in the paper

    Returns {"frames": n, "fn" | "fp" | "tp": {"iob": {"mean", "std"}, "ioe": {"mean", "std"}}, "compromised": {agent:
    {"fn" | "fp": {"mean", "std"}}}, "cafn" | "cafp" | "cafn_centre" | "cafp_centre": {"mean", "std"}}.
    IoB is the attacked picture minus the baseline's in the same frame; IoE is the attacked picture minus the agent's
    own tracks in the same run. These are the paper's columns "ERCC". Its columns CAFN and CAFP, of the compromised
    agents, are the increments over the baseline of the agents' OWN tracks (`alone`), pooled over agents and frames.
    The paper's numbers are those of the command centre: "cafn_centre" and "cafp_centre", of its picture (`estimator`)
    in range of the compromised agents.
    Only frames in both runs are compared; without any, means and deviations are None.
    Raises ValueError with the table and the series if a run has no scores of a required series.
    """
    before = _counts(baseline, "baseline", agent, estimator)
    after = _counts(attacked, "attacked", agent, estimator)
    own = _counts(attacked, "attacked", agent, alone)
    frames = _common(first_frame, before, after, own)
    result: dict[str, Any] = {"frames": len(frames)}
    for column, name in enumerate(COUNTS):
        attacked_counts = _at(after, frames)[:, column]
        result[name] = {
            "iob": mean_and_std(attacked_counts - _at(before, frames)[:, column]),
            "ioe": mean_and_std(attacked_counts - _at(own, frames)[:, column]),
        }
    own_rows, centre_rows = (
        {victim: _differences(baseline, attacked, victim, each, first_frame) for victim in compromised}
        for each in (alone, estimator)
    )
    result["compromised"] = {
        victim: {name: mean_and_std(rows[:, column]) for column, name in enumerate(COUNTS) if name != "tp"}
        for victim, rows in own_rows.items()
    }
    for suffix, rows_by_victim in (("", own_rows), ("_centre", centre_rows)):
        pooled = np.concatenate([np.zeros((0, len(COUNTS))), *rows_by_victim.values()])
        result[f"cafn{suffix}"], result[f"cafp{suffix}"] = mean_and_std(pooled[:, 0]), mean_and_std(pooled[:, 1])
    return result


def _differences(baseline: Table, attacked: Table, agent: str, estimator: str, first_frame: int | None) -> Floats:
    """Increments (f, 3) of fn, fp, tp of one series, in the frames that both runs have."""
    before, after = (
        _counts(table, label, agent, estimator) for table, label in ((baseline, "baseline"), (attacked, "attacked"))
    )
    frames = _common(first_frame, before, after)
    return _at(after, frames) - _at(before, frames)


def _counts(table: Table, label: str, agent: str, estimator: str) -> Table:
    """The rows of one series."""
    mask = (table["agent"] == agent) & (table["estimator"] == estimator)
    if not mask.any():
        known = sorted({f"{a}/{e}" for a, e in zip(table["agent"], table["estimator"], strict=True)})
        raise ValueError(f"{label}: found {', '.join(known) or 'no series'}, expected one of {agent}/{estimator}")
    return {name: table[name][mask] for name in ("frame", *COUNTS)}


def _common(first_frame: int | None, *tables: Table) -> Floats:
    """The frames common to all tables, ascending."""
    frames = tables[0]["frame"]
    for table in tables[1:]:
        frames = np.intersect1d(frames, table["frame"])
    return np.unique(frames if first_frame is None else frames[frames >= first_frame])


def _at(table: Table, frames: Floats) -> Floats:
    """Counts (f, 3) of fn, fp, tp in these frames."""
    order = np.argsort(table["frame"], kind="stable")
    rows = order[np.searchsorted(table["frame"][order], frames)]
    return np.column_stack([table[name][rows] for name in COUNTS]).astype(np.float64)
