"""Which false tracks follow objects to where an adversary moved them. Pure; see docs/metrics.md."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.metrics.manipulations import MOVED, Manipulations
from mast_zenoh.metrics.places import Places, nearest
from mast_zenoh.metrics.scores import Scores, Texts


def followed(
    scores: Scores,
    tracks: Bools,
    by: Texts,
    done: Manipulations,
    targets: Ints,
    truth: Ints,
    *,
    near_m: float,
    off_m: float,
) -> Floats:
    """(n,) m, how far the false track that follows each displaced object is from the object itself; NaN: none does.

    A false track that is due to an adversary's moving things follows the object that this adversary shows nearest to
    it and within `near_m`, if it is nearer to where that is shown than to where it is, and more than `off_m`
    from there.

    tracks:         (m,) bool, the rows of `scores.judged` that are such tracks
    by:             (m,) to whom each of these rows is due
    targets, truth: (n,) rows of `done`, and of the true objects in `scores.judged`
    """
    judged, result = scores.judged, np.full(len(targets), np.nan)
    nearest_m = np.full(len(targets), np.inf)
    row_of = np.full(len(done), -1)
    row_of[targets] = np.arange(len(targets))
    for index, name in enumerate(done.culprits):
        moved = np.flatnonzero((done.kind == MOVED) & (done.culprit == index))
        mine = np.flatnonzero(tracks)
        mine = mine[np.array([name in each.split("+") for each in by[mine].tolist()], bool)]
        places = Places(judged.frame[mine], judged.boxes.position[mine])
        at, apart = nearest(places, Places(done.frame[moved], done.position[moved]), near_m)
        mine, target, apart = mine[at >= 0], row_of[moved[at[at >= 0]]], apart[at >= 0]
        mine, target, apart = mine[target >= 0], target[target >= 0], apart[target >= 0]
        offset = (judged.boxes.position[mine] - judged.boxes.position[truth[target]])[:, :2]
        error = np.hypot(offset[:, 0], offset[:, 1])
        follows = (error > off_m) & (apart < error)
        for k in np.flatnonzero(follows)[np.argsort(apart[follows], kind="stable")].tolist():
            if apart[k] < nearest_m[target[k]]:
                nearest_m[target[k]], result[target[k]] = apart[k], error[k]
    return result
