"""AMOTA, sAMOTA and AMOTP: tracking accuracy averaged over recall, for tracks ranked by their scores.

Weng, Wang, Held and Kitani, "3D Multi-Object Tracking: A Baseline and New Evaluation Metrics", IROS 2020, section IV.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.metrics.scores import FALSE, Scores

#: Number of recall levels 1/L, 2/L, ..., 1, as in the paper.
LEVELS = 40


def ranked_accuracy(
    object_id: Ints, track_id: Ints, score: Floats, error_m: Floats, n_objects: int, levels: int = LEVELS
) -> dict[str, float | None]:
    """AMOTA, sAMOTA and AMOTP of one estimate of a run.

    object_id: (n,) of the object that each track box matches, -1: a false one; in order of time
    track_id, score: (n,) of the box; error_m: (n,) m, distance to the object, ignored for a false box
    n_objects: number of truth boxes, matched or not

    The confidence of a track is the mean score of its boxes. For each level r of recall, all tracks down to the
    greatest confidence that reaches it are kept, and FP, FN and identity switches (IDS) counted:

        MOTA_r = 1 - (FP + FN + IDS) / n_objects                                     amota: mean over the levels
        sMOTA_r = max(0, 1 - (FP + FN + IDS - (1 - r) n_objects) / (r n_objects))    samota: mean over the levels
        MOTP_r = mean error of the kept pairs                                        amotp_m: mean over those reached

    In sMOTA_r, r is the recall that is reached, so that the term is (FP + IDS) / pairs and at most 1. A level that is
    not reached counts as 0 for AMOTA and sAMOTA. Values that are undefined are None.
    """
    if n_objects == 0:
        return {"amota": None, "samota": None, "amotp_m": None}
    track = np.unique(track_id, return_inverse=True)[1].reshape(-1)
    total, boxes = np.bincount(track, score), np.bincount(track)
    confidence = (total / np.maximum(boxes, 1)).take(track)
    pair = object_id >= 0
    # Down to each confidence, the numbers of pairs and of false boxes; equal confidences are kept together.
    limits, rank = np.unique(-confidence, return_inverse=True)
    rank = rank.reshape(-1)
    true_positives = np.bincount(rank[pair], minlength=len(limits)).cumsum()
    false_positives = np.bincount(rank[~pair], minlength=len(limits)).cumsum()
    errors = np.bincount(rank[pair], error_m[pair], minlength=len(limits)).cumsum()
    recall = np.arange(1, levels + 1) / levels
    reached = true_positives.searchsorted(recall * n_objects - 1e-9)
    reached = reached[reached < len(limits)]
    if len(reached) == 0:
        return {"amota": 0.0, "samota": 0.0, "amotp_m": None}
    by_object = np.argsort(object_id[pair], kind="stable")
    switches = _switches(object_id[pair][by_object], track[pair][by_object], rank[pair][by_object], reached)
    pairs, n_errors = true_positives[reached], false_positives[reached] + switches
    return {
        "amota": float(((pairs - n_errors) / n_objects).sum() / levels),
        "samota": float(np.maximum(1.0 - n_errors / pairs, 0.0).sum() / levels),
        "amotp_m": float((errors[reached] / pairs).mean()),
    }


def _switches(object_id: Ints, track: Ints, rank: Ints, limits: Ints) -> Ints:
    """Identity switches among the pairs with a rank up to each limit (k,); pairs sorted by object, then time."""
    counts = {}
    for limit in np.unique(limits).tolist():
        kept = rank <= limit
        objects, tracks = object_id[kept], track[kept]
        counts[limit] = np.count_nonzero((objects[1:] == objects[:-1]) & (tracks[1:] != tracks[:-1]))
    return np.array([counts[limit] for limit in limits.tolist()], np.int64)


def mean_ranking(parts: Sequence[tuple[dict[str, Any], int]]) -> dict[str, Any]:
    """The mean of the values of several parts of a run, each with its number of objects."""
    if len(parts) == 1:
        return parts[0][0]
    result = {}
    for name in parts[0][0]:
        known = [(values[name], objects) for values, objects in parts if values[name] is not None]
        total = sum(objects for _, objects in known)
        result[name] = sum(value * objects for value, objects in known) / total if total else None
    return result


def rankings(scores: Scores, scored: slice) -> list[dict[str, Any]]:
    """`ranked_accuracy` of each row of `scores.series`, over the frames that count.

    scored: rows of `scores.frames`, with a start and a stop

    The matching is that of all tracks. It is not repeated for each level.
    """
    judged = scores.judged
    false = judged.is_track & (judged.outcome == FALSE) & np.isin(judged.frame, scores.frames[scored])
    rows = false.nonzero()[0]
    begin = judged.series[rows].searchsorted(np.arange(len(scores.series) + 1)).tolist()
    result = []
    for series in range(len(scores.series)):
        objects, tracks, score, error_m = scores.pairs.ranked(series, scored)
        false_rows = rows[begin[series] : begin[series + 1]]
        result.append(
            ranked_accuracy(
                np.concatenate([objects, np.full(len(false_rows), -1)]),
                np.concatenate([tracks, judged.id[false_rows]]),
                np.concatenate([score, judged.score[false_rows]]),
                np.concatenate([error_m, np.zeros(len(false_rows))]),
                int((scores.tp + scores.fn)[series, scored].sum()),
            )
        )
    return result
