"""What attribution says of a whole run: how much of what is wrong is whose doing, and how soon it began."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mast_zenoh.metrics.attribution import ATTACK_CAUSES, CAUSES, FAULT_CAUSES
from mast_zenoh.metrics.record import PICTURE
from mast_zenoh.metrics.scores import Table
from mast_zenoh.states import Ints


def cause_counts(objects: Table, agents: Sequence[str], frames: Ints) -> dict[str, dict[str, dict[str, int]]]:
    """By agent, {"fp" | "fn": {cause: number of rows}} of its picture in these frames; causes that occur only.

    objects: `Scores.objects` with the column `cause` of `Attribution.label`
    """
    rows = np.flatnonzero(objects["cause"] != "")
    rows = rows[np.isin(objects["frame"][rows], frames)]
    agent, cause = objects["agent"][rows], objects["cause"][rows]
    false = objects["kind"][rows] == "track"
    result: dict[str, dict[str, dict[str, int]]] = {}
    for name in agents:
        mine = agent == name
        counted = {
            what: {each: int(np.count_nonzero(mine & of & (cause == each))) for each in CAUSES}
            for what, of in (("fp", false), ("fn", ~false))
        }
        result[name] = {what: {each: n for each, n in counts.items() if n} for what, counts in counted.items()}
    return result


def split(counts: Mapping[str, int], frames: int) -> dict[str, float | None]:
    """{"fault", "attack", "natural"}: objects per frame, mean over `frames`; None without a frame.

    counts: rows by cause, as `cause_counts` has them for "fp" or "fn"
    """
    rows = {"fault": sum(counts.get(cause, 0) for cause in FAULT_CAUSES)}
    rows["attack"] = sum(counts.get(cause, 0) for cause in ATTACK_CAUSES)
    rows["natural"] = sum(counts.values()) - sum(rows.values())
    return {who: number / frames if frames else None for who, number in rows.items()}


def time_to_first_false(objects: Table, attacks: Table, period_s: float) -> dict[str, float | None]:
    """By adversary that has injected anything: s from its first false object to the first false track of one of its
    objects in the picture (of any agent); None: there was none."""
    adversary, action = (np.asarray(attacks[name], str) for name in ("adversary", "action"))
    rows = np.flatnonzero(objects["cause"] == "injected")
    rows = rows[(objects["estimator"][rows] == PICTURE) & (objects["kind"][rows] == "track")]
    frame, blamed = objects["frame"][rows], objects["by"][rows]
    names, which = np.unique(blamed, return_inverse=True)
    first: dict[str, Any] = {}
    for name in np.unique(adversary[action == "added"]):
        began = attacks["frame"][(adversary == name) & (action == "added")].min()
        guilty = np.array([name in each.split("+") for each in names], bool)
        seen = frame[guilty[which]] if len(names) else frame
        seen = seen[seen >= began]
        first[str(name)] = float(seen.min() - began) * period_s if len(seen) else None
    return first
