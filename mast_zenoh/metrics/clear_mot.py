"""Precision, recall and MOTA, which sum up a run's errors.

MOTA: Bernardin and Stiefelhagen, "Evaluating Multiple Object Tracking Performance: The CLEAR MOT Metrics", EURASIP
Journal on Image and Video Processing 2008, section 2.1.3.
"""

from __future__ import annotations


def clear_mot(tp: int, fp: int, fn: int, id_switches: int) -> dict[str, float | None]:
    """Precision, recall and MOTA of one estimate of a run.

    tp, fp, fn: matched pairs, false tracks and missed objects, summed over the frames; id_switches: identity switches

        precision = tp / (tp + fp)
        recall    = tp / (tp + fn)
        mota      = 1 - (fn + fp + id_switches) / (tp + fn)     at most 1; negative with more errors than objects

    None where the denominator is 0.
    """
    tracks, objects = tp + fp, tp + fn
    return {
        "precision": tp / tracks if tracks else None,
        "recall": tp / objects if objects else None,
        "mota": 1.0 - (fn + fp + id_switches) / objects if objects else None,
    }
