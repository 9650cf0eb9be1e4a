"""The success of each adversary as numbers for metrics.json.

Pure; see docs/metrics.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Ints
from mast_zenoh.metrics.achievement import Targets
from mast_zenoh.metrics.manipulations import ALTERED, INSERTED, MOVED, REMOVED
from mast_zenoh.metrics.record import MISSION, PICTURE
from mast_zenoh.metrics.scores import Scores, Texts

#: Name in the summary of all adversaries together.
ALL = "all"
#: s; a hidden or moved object counts as such if it was missed or displaced for longer than this and in more than half
#: of the manipulated frames: natural errors are short.
LASTING_S = 1.0


def summary(
    targets_: Targets,
    culprits: tuple[str, ...],
    scores: Scores,
    switch_by: Texts,
    ego: str,
    period_s: float,
    scored: slice = slice(None),
) -> dict[str, dict[str, Any]]:
    """Results by adversary, and of ALL together; {} without adversaries.

    See docs/metrics.md.

    switch_by: the adversaries responsible for each of `scores.switches`
    scored:    the frames in which identity switches count, as in the summary of scores
    """
    if not culprits:
        return {}
    real = (targets_.kind == INSERTED) | (targets_.object >= 0)
    groups = {name: (real & (targets_.adversary == index)).nonzero()[0] for index, name in enumerate(culprits)}
    counts = np.zeros(len(scores.frames), bool)
    counts[scored] = True
    result = {}
    merged = _merge(targets_, real.nonzero()[0])
    by_name = {name: (targets_, rows) for name, rows in groups.items()} | {ALL: (merged, np.arange(len(merged.kind)))}
    for name, (targets_of, rows) in by_name.items():
        attributed = np.array([by != "" if name == ALL else name in by.split("+") for by in switch_by.tolist()], bool)
        result[name] = _results(targets_of, rows, period_s)
        for estimate_name, estimate in (("centre", (ego, PICTURE)), ("ego", (ego, MISSION))):
            in_estimate = np.array([each == estimate for each in scores.series], bool)
            counted = attributed & in_estimate[scores.switches.series] & counts[scores.switches.frame]
            result[name][f"id_switches_{estimate_name}"] = int(np.count_nonzero(counted))
    return result


def _merge(targets_: Targets, rows: Ints) -> Targets:
    """The targets in `rows`, merged if they have the same object and frame.

    Several adversaries may have manipulated the same object.
    A merged target is believed if any of its parts is; its error is the largest.
    """
    _, first, group = np.unique(
        np.column_stack([targets_.kind, targets_.object, targets_.frame])[rows],
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    believed = {name: np.bincount(group, values[rows], len(first)) > 0 for name, values in targets_.believed.items()}
    error = {name: np.full(len(first), np.nan) for name in targets_.error_m}
    for name, values in targets_.error_m.items():
        np.fmax.at(error[name], group, values[rows])
    first_rows = rows[first]
    return Targets(
        targets_.adversary[first_rows],
        targets_.kind[first_rows],
        targets_.frame[first_rows],
        targets_.object[first_rows],
        targets_.position[first_rows],
        believed,
        {name: values[first_rows] for name, values in targets_.judged.items()},
        error,
        targets_.by_others[first_rows],
    )


def _results(targets_: Targets, rows: Ints, period_s: float) -> dict[str, Any]:
    result: dict[str, Any] = {}
    success = dict.fromkeys(targets_.believed, rows[:0])
    for kind_name, kinds in (
        ("inserted", (INSERTED,)),
        ("hidden", (REMOVED,)),
        ("moved", (MOVED,)),
        ("altered", (ALTERED,)),
    ):
        of_kind = rows[np.isin(targets_.kind[rows], kinds)]
        objects, object_row = np.unique(targets_.object[of_kind], return_inverse=True)
        result[kind_name] = len(objects)
        if not len(objects):
            continue
        result[f"{kind_name}_frames"] = len(of_kind)
        for estimate_name in targets_.believed:
            judged, believed = (
                targets_.judged[estimate_name][of_kind],
                (targets_.believed[estimate_name] & targets_.judged[estimate_name])[of_kind],
            )
            frames = np.bincount(object_row, believed, len(objects))
            judged_frames = np.bincount(object_row, judged, len(objects))
            if kind_name == "inserted":
                lasting = frames > 0
            else:
                lasting = (frames * period_s > LASTING_S - 1e-9) & (2 * frames > judged_frames)
            result[f"{kind_name}_share_{estimate_name}"] = (
                float(lasting[judged_frames > 0].mean()) if judged_frames.any() else None
            )
            result[f"{kind_name}_time_share_{estimate_name}"] = float(believed[judged].mean()) if judged.any() else None
            if kind_name == "inserted":
                result[f"inserted_s_{estimate_name}"] = (
                    float(frames[lasting].mean() * period_s) if lasting.any() else None
                )
            if kind_name in ("moved", "altered"):
                error = targets_.error_m[estimate_name][of_kind]
                finite = error[np.isfinite(error)]
                result[f"{kind_name}_error_m_{estimate_name}"] = float(finite.mean()) if len(finite) else None
            success[estimate_name] = np.concatenate([success[estimate_name], of_kind[believed & lasting[object_row]]])
        if kind_name != "inserted":
            result[f"{kind_name}_seen_by_others"] = float(targets_.by_others[of_kind].mean())
    for estimate_name, hits in success.items():
        result[f"success_{estimate_name}"] = bool(len(hits))
        delay_frames = targets_.frame[hits].min() - targets_.frame[rows].min() if len(hits) else None
        result[f"first_success_s_{estimate_name}"] = None if delay_frames is None else float(delay_frames * period_s)
    return result
