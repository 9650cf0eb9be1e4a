"""The box tracker on filterpy: slow, and the reference that the batched filter must agree with."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from mast_zenoh.states import Floats
from mast_zenoh.tracking import kalman
from mast_zenoh.tracking.box_tracker import KalmanBoxTracker3D

if TYPE_CHECKING:
    from filterpy.kalman import KalmanFilter


class FilterpyFilter(kalman.BoxFilter):
    """One filterpy filter per track and call."""

    def predict(self, mean: Floats, covariance: Floats, dt: float, noise: Floats) -> tuple[Floats, Floats]:
        transition = np.eye(9)
        transition[kalman.POSITION, kalman.VELOCITY] = dt * np.eye(3)
        filters = [_filter(x, P, 1) for x, P in zip(mean, covariance, strict=True)]
        for one, Q in zip(filters, noise, strict=True):
            one.predict(F=transition, Q=Q)
        return _collect(filters)

    def correct(
        self, mean: Floats, covariance: Floats, part: slice, measured: Floats, noise: Floats
    ) -> tuple[Floats, Floats]:
        picks = np.eye(9)[part]
        filters = [_filter(x, P, len(picks)) for x, P in zip(mean, covariance, strict=True)]
        for one, z, R in zip(filters, measured, noise, strict=True):
            one.update(z, R=R, H=picks)
        return _collect(filters)

    def correct_speed(
        self, mean: Floats, covariance: Floats, direction: Floats, noise: Floats
    ) -> tuple[Floats, Floats]:
        filters = [_filter(x, P, 1) for x, P in zip(mean, covariance, strict=True)]
        for one, (x, y), variance in zip(filters, direction, noise, strict=True):
            picks = np.zeros((1, 9))
            picks[0, 6:8] = x, y
            one.update(np.zeros(1), R=np.array([[variance]]), H=picks)
        return _collect(filters)


class FilterpyBoxTracker3D(KalmanBoxTracker3D):
    """`KalmanBoxTracker3D` with `filterpy.kalman.KalmanFilter` for prediction and correction, track by track."""

    filter: ClassVar[kalman.BoxFilter] = FilterpyFilter()


def _filter(mean: Floats, covariance: Floats, measured: int) -> KalmanFilter:
    # Here, not above: filterpy pulls in matplotlib, which takes half a second that only this tracker need pay.
    from filterpy.kalman import KalmanFilter

    one = KalmanFilter(dim_x=9, dim_z=measured)
    one.x, one.P = mean.copy(), covariance.copy()
    return one


def _collect(filters: list[KalmanFilter]) -> tuple[Floats, Floats]:
    n = len(filters)
    return np.array([one.x for one in filters]).reshape(n, 9), np.array([one.P for one in filters]).reshape(n, 9, 9)
