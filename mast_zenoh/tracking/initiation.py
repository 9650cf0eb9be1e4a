"""New tracks."""

from __future__ import annotations

from typing import Any

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking import tracks
from mast_zenoh.tracking.classes import FIRST_SPEED, first_covariance
from mast_zenoh.tracking.evidence import FIRST_DUE
from mast_zenoh.tracking.measured import Measured


def created(explained: Bools, measured: Measured, first_id: int, yaw_variance: float, odds: float) -> Floats:
    """New tracks (k, WIDTH) for the measurements that are not explained (m,).

    first_id: of the first one, the others follow; yaw_variance: rad^2; odds: of existence
    """
    return new_tracks(explained, measured, first_id, (yaw_variance, odds, FIRST_DUE), FIRST_SPEED)


@kernel
def new_tracks(
    explained: Bools,
    measured: tuple[Any, ...],
    first_id: int,
    constants: tuple[float, float, float],
    speed: tuple[Floats, Floats, float],
) -> Floats:
    """New tracks (k, WIDTH) for the measurements that are not explained (m,).

    measured: the fields of `Measured`
    constants: yaw_variance, odds and FIRST_DUE; speed: `classes.FIRST_SPEED`, where velocities are not measured
    """
    row, state, noise, yaw, class_id, score = (column[~explained] for column in measured)
    new = tracks.empty(len(row))
    new[:, : state.shape[1]] = state
    P = noise if state.shape[1] == 9 else first_covariance(noise, yaw, class_id)
    new[:, tracks.COVARIANCE] = P.reshape(len(row), 81)
    new[:, tracks.ID] = np.arange(first_id, first_id + len(row))
    new[:, tracks.YAW_VARIANCE], new[:, tracks.ODDS], new[:, tracks.DUE] = constants
    new[:, tracks.TURN] = new[:, tracks.HITS] = 1.0
    new[:, tracks.YAW], new[:, tracks.ROW], new[:, tracks.SCORE] = yaw, row, score
    tracks.update_class(new, class_id)
    return new
