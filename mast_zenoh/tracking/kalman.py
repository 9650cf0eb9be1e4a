"""The Kalman filter of the box trackers, batched.

State [x y z l w h vx vy vz] (`states.COVARIANCE_ORDER`). Position and velocity follow the white-acceleration model
(Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 6.2.2), sizes a
random walk.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import lru_cache

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.inversion import inverse
from mast_zenoh.tracking.tracks import COVARIANCE, MEAN, classes_of, covariances

POSITION = slice(0, 3)
BOX = slice(0, 6)
VELOCITY = slice(6, 9)


def process_noise(dt: float, acceleration: Floats, vertical: float, size_drift: float) -> Floats:
    """(n, 9, 9) process noise covariance Q over `dt` s.

    acceleration: (n,) m^2/s^3, spectral density of the horizontal acceleration; vertical: of the vertical acceleration
    size_drift: m^2/s, growth of the variance of each size
    """
    horizontal, other = _unit_noise(dt, vertical, size_drift)
    return np.asarray(acceleration[:, None, None] * horizontal + other)


@lru_cache(maxsize=8)
def _unit_noise(dt: float, vertical: float, size_drift: float) -> tuple[Floats, Floats]:
    """Covariances (9, 9) of unit-density horizontal motion and of the other states."""
    horizontal, other = np.zeros((2, 9, 9))
    for axis, matrix, density in ((0, horizontal, 1.0), (1, horizontal, 1.0), (2, other, vertical)):
        matrix[axis, axis] = density * dt**3 / 3
        matrix[axis, axis + 6] = matrix[axis + 6, axis] = density * dt**2 / 2
        matrix[axis + 6, axis + 6] = density * dt
    other[(3, 4, 5), (3, 4, 5)] = size_drift * dt
    horizontal.setflags(write=False)
    other.setflags(write=False)
    return horizontal, other


@lru_cache(maxsize=8)
def _transition(dt: float) -> Floats:
    """(9, 9) transition matrix F of motion at constant velocity."""
    matrix = np.eye(9)
    matrix[POSITION, VELOCITY] = dt * np.eye(3)
    matrix.setflags(write=False)
    return matrix


class BoxFilter(ABC):
    """Predicts and corrects the n rows of a table of tracks in place."""

    @abstractmethod
    def predict(self, t: Floats, dt: float, noise: Floats) -> None:
        """Predict by `dt` s; noise: (classes, 9, 9), process noise by class."""

    @abstractmethod
    def correct(self, t: Floats, measured: Floats, noise: Floats) -> None:
        """Correct by measurements (n, m) of the first m state components.

        noise: (n, m, m), measurement covariance
        """

    @abstractmethod
    def correct_speed(self, t: Floats, direction: Floats, noise: Floats) -> None:
        """Correct by measuring the speed along `direction` as 0.

        direction: (n, 2), horizontal unit vectors; noise: (n,) (m/s)^2, measurement variance
        """


class BatchedFilter(BoxFilter):
    """Filters all tracks at once with NumPy."""

    def predict(self, t: Floats, dt: float, noise: Floats) -> None:
        predict(t, dt, noise)

    def correct(self, t: Floats, measured: Floats, noise: Floats) -> None:
        correct(t, measured, noise)

    def correct_speed(self, t: Floats, direction: Floats, noise: Floats) -> None:
        correct_speed(t, direction, noise)


@kernel
def predict(t: Floats, dt: float, noise: Floats) -> None:
    """Predict all tracks as in `BoxFilter.predict`."""
    F = _transition(dt)
    P = F @ covariances(t) @ F.T
    P += noise.take(classes_of(t), 0)
    t[:, MEAN], t[:, COVARIANCE] = t[:, MEAN] @ F.T, P.reshape(len(t), 81)


@kernel
def correct(t: Floats, measured: Floats, noise: Floats) -> None:
    """Correct all tracks as in `BoxFilter.correct`."""
    m = measured.shape[1]
    P = covariances(t)
    cross = P[:, :, :m]
    total = cross[:, :m] + noise
    gain = cross @ (inverse(total) if m == 9 else np.linalg.inv(total))
    corrected = P - gain @ cross.transpose(0, 2, 1)
    t[:, MEAN] += (gain @ (measured - t[:, :m])[:, :, None])[:, :, 0]
    # Symmetrised because this form amplifies rounding asymmetries.
    t[:, COVARIANCE] = (0.5 * (corrected + corrected.transpose(0, 2, 1))).reshape(len(t), 81)


@kernel
def correct_speed(t: Floats, direction: Floats, noise: Floats) -> None:
    """Correct the speed of all tracks as in `BoxFilter.correct_speed`."""
    P = covariances(t)
    cross = (P[:, :, 6:8] @ direction[:, :, None])[:, :, 0]
    variance = np.vecdot(cross[:, 6:8], direction) + noise
    speed = np.vecdot(t[:, 6:8], direction)
    t[:, MEAN] -= cross * (speed / variance)[:, None]
    scaled = cross / np.sqrt(variance)[:, None]
    t[:, COVARIANCE] -= (scaled[:, :, None] * scaled[:, None, :]).reshape(len(t), 81)
