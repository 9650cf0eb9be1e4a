"""False tracks of objects that an adversary moved. Pure; see docs/metrics.md."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.manipulations import MOVED, Manipulations
from mast_zenoh.metrics.places import Places, nearest
from mast_zenoh.metrics.scores import Scores, Texts


def false_track_errors(
    scores: Scores,
    tracks: Bools,
    by: Texts,
    manipulations: Manipulations,
    targets: Ints,
    truth: Ints,
    *,
    near_m: float,
    off_m: float,
) -> Floats:
    """(n,) m, distance between each displaced object and its false track; NaN: none.

    A false track caused by an adversary belongs to the nearest object that this adversary moved, within `near_m` of its
    false position, if the track is nearer to the false than to the true position and more than `off_m` from the latter.

    tracks:         (m,) bool, the rows of `scores.judged` that are such tracks
    by:             (m,) the adversaries responsible for each row
    targets, truth: (n,) rows of `manipulations`, and of the true objects in `scores.judged`
    """
    judged, result = scores.judged, np.full(len(targets), np.nan)
    nearest_m = np.full(len(targets), np.inf)
    row_of = np.full(len(manipulations), -1)
    row_of[targets] = np.arange(len(targets))
    for index, name in enumerate(manipulations.culprits):
        moved = np.flatnonzero((manipulations.kind == MOVED) & (manipulations.culprit == index))
        track_rows = np.flatnonzero(tracks)
        track_rows = track_rows[np.array([name in each.split("+") for each in by[track_rows].tolist()], bool)]
        places = Places(judged.frame[track_rows], judged.boxes.position[track_rows])
        at, distance = nearest(places, Places(manipulations.frame[moved], manipulations.position[moved]), near_m)
        track_rows, target, distance = track_rows[at >= 0], row_of[moved[at[at >= 0]]], distance[at >= 0]
        track_rows, target, distance = track_rows[target >= 0], target[target >= 0], distance[target >= 0]
        offset = (judged.boxes.position[track_rows] - judged.boxes.position[truth[target]])[:, :2]
        error = np.hypot(offset[:, 0], offset[:, 1])
        follows = (error > off_m) & (distance < error)
        for k in np.flatnonzero(follows)[np.argsort(distance[follows], kind="stable")].tolist():
            if distance[k] < nearest_m[target[k]]:
                nearest_m[target[k]], result[target[k]] = distance[k], error[k]
    return result
