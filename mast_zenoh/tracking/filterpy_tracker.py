"""The box tracker on filterpy: slow, and the reference that the batched filter must agree with."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

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
            one = _filter(row, 1)
            one.predict(F=transition, Q=Q)
            _store(one, row)

    def correct(self, t: Floats, measured: Floats, noise: Floats) -> None:
        m = measured.shape[1]
        for row, z, R in zip(t, measured, noise, strict=True):
            one = _filter(row, m)
            one.update(z, R=R, H=np.eye(9)[:m])
            _store(one, row)

    def correct_speed(self, t: Floats, direction: Floats, noise: Floats) -> None:
        for row, (x, y), variance in zip(t, direction, noise, strict=True):
            picks = np.zeros((1, 9))
            picks[0, 6:8] = x, y
            one = _filter(row, 1)
            one.update(np.zeros(1), R=np.array([[variance]]), H=picks)
            _store(one, row)


class FilterpyBoxTracker3D(KalmanBoxTracker3D):
    """`KalmanBoxTracker3D` with `filterpy.kalman.KalmanFilter` for prediction and correction, track by track."""

    filter: ClassVar[kalman.BoxFilter] = FilterpyFilter()


def _filter(track: Floats, measured: int) -> KalmanFilter:
    # Here, not above: filterpy pulls in matplotlib, which takes half a second that only this tracker need pay.
    from filterpy.kalman import KalmanFilter

    one = KalmanFilter(dim_x=9, dim_z=measured)
    one.x, one.P = track[tracks.MEAN].copy(), track[tracks.COVARIANCE].reshape(9, 9).copy()
    return one


def _store(one: KalmanFilter, track: Floats) -> None:
    track[tracks.MEAN], track[tracks.COVARIANCE] = one.x, one.P.ravel()
