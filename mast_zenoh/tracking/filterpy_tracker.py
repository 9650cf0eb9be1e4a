"""The box tracker with filterpy: slow, a reference for the batched filter."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.tracking import kalman, tracks
from mast_zenoh.tracking.box_tracker import KalmanBoxTracker3D

if TYPE_CHECKING:
    from filterpy.kalman import KalmanFilter


class FilterpyFilter(kalman.BoxFilter):
    """One filterpy filter per track and call."""

    def predict(self, t: Floats, dt: float, noise: Floats) -> None:
        transition = np.eye(9)
        transition[kalman.POSITION, kalman.VELOCITY] = dt * np.eye(3)
        for row, Q in zip(t, noise[tracks.classes_of(t)], strict=True):
            box_filter = _filter(row, 1)
            box_filter.predict(F=transition, Q=Q)
            _store(box_filter, row)

    def correct(self, t: Floats, measured: Floats, noise: Floats) -> None:
        m = measured.shape[1]
        for row, z, R in zip(t, measured, noise, strict=True):
            box_filter = _filter(row, m)
            box_filter.update(z, R=R, H=np.eye(9)[:m])
            _store(box_filter, row)

    def correct_speed(self, t: Floats, direction: Floats, noise: Floats) -> None:
        for row, (x, y), variance in zip(t, direction, noise, strict=True):
            observation = np.zeros((1, 9))
            observation[0, 6:8] = x, y
            box_filter = _filter(row, 1)
            box_filter.update(np.zeros(1), R=np.array([[variance]]), H=observation)
            _store(box_filter, row)


class FilterpyBoxTracker3D(KalmanBoxTracker3D):
    """`KalmanBoxTracker3D` with `filterpy.kalman.KalmanFilter`, one track at a time."""

    filter = FilterpyFilter()


def _filter(track: Floats, measured: int) -> KalmanFilter:
    # Imported here because filterpy imports matplotlib, which takes half a second.
    from filterpy.kalman import KalmanFilter

    box_filter = KalmanFilter(dim_x=9, dim_z=measured)
    box_filter.x, box_filter.P = track[tracks.MEAN].copy(), track[tracks.COVARIANCE].reshape(9, 9).copy()
    return box_filter


def _store(box_filter: KalmanFilter, track: Floats) -> None:
    track[tracks.MEAN], track[tracks.COVARIANCE] = box_filter.x, box_filter.P.ravel()
