"""New tracks."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.tracking import tracks
from mast_zenoh.tracking.evidence import FIRST_DUE
from mast_zenoh.tracking.measured import Measured


def created(rows: Ints, measurements: Measured, first_id: int, yaw_variance: float) -> Floats:
    """New tracks (k, WIDTH) for the measurements in `rows`, without mean, covariance and odds.

    first_id: of the first one, the others follow; yaw_variance: rad^2
    """
    new = tracks.empty(len(rows))
    new[:, tracks.ID] = np.arange(first_id, first_id + len(rows))
    new[:, tracks.YAW], new[:, tracks.YAW_VARIANCE] = measurements.yaw[rows], yaw_variance
    new[:, tracks.TURN] = 1.0
    new[:, tracks.HITS], new[:, tracks.ROW] = 1.0, measurements.row[rows]
    new[:, tracks.SCORE], new[:, tracks.DUE] = measurements.score[rows], FIRST_DUE
    tracks.update_class(new, measurements.class_id[rows])
    return new
