"""The Kalman filter of the box trackers, batched, with its prediction for other trackers' states;
covariances made usable, and their inverses.

State [x y z l w h vx vy vz] (`states.COVARIANCE_ORDER`). Position and velocity follow the white-acceleration model
(Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 6.2.2), sizes a
random walk. Wheeled objects move along their heading.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import lru_cache

import numpy as np

from mast_zenoh.arrays.states import Floats, ObjectStates, propagate
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.classes import ACCELERATION, SIZE_DRIFT, VERTICAL_ACCELERATION, WHEELED
from mast_zenoh.tracking.tracks import (
    COVARIANCE,
    LATERAL_RESIDUAL,
    MEAN,
    YAW,
    YAW_VARIANCE,
    classes_of,
    covariances,
    planar,
)

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


#: m/s, lateral slip of a wheeled object, as in a tight turn about a point other than the box's centre.
SLIP = 0.5
#: Weight of a new residual in the running mean, which spans about five.
RESIDUAL_WEIGHT = 0.2
#: s: a mean lateral residual of 15 cm indicates an unmodelled lateral speed of 1 m/s.
RESIDUAL_S = 0.15
#: (m/s)^2 by class, variance that disables the constraint for objects without wheels.
_UNCONSTRAINED = np.where(WHEELED, 0.0, 1e9)


def constrain_lateral_speed(box_filter: BoxFilter, tracks: Floats, innovation: Floats) -> None:
    """Correct `tracks` by a measured lateral speed of zero.

    The variance follows from slip and heading uncertainty.

    innovation: (n, 2) m, measured minus predicted position. A persistent lateral bias indicates a wrong heading.
    """
    direction, variance = lateral_constraint(tracks, innovation, _UNCONSTRAINED, SLIP, RESIDUAL_WEIGHT, RESIDUAL_S)
    box_filter.correct_speed(tracks, direction, variance)


@kernel
def lateral_constraint(
    tracks: Floats, innovation: Floats, free: Floats, slip: float, share: float, time_s: float
) -> tuple[Floats, Floats]:
    """Lateral unit vectors (n, 2), and variances (n,) (m/s)^2 of the speed along them.

    free: by class, (m/s)^2, added variance; slip, share, time_s: SLIP, RESIDUAL_WEIGHT, RESIDUAL_S
    """
    # Planar vectors as complex numbers: multiplied by the conjugate of the heading, they are along and across it.
    heading = np.exp(1j * tracks[:, YAW])
    residual = tracks[:, LATERAL_RESIDUAL]
    residual += share * ((planar(innovation) * heading.conj()).imag - residual)
    speed = np.abs(planar(tracks[:, 6:8]))
    variance = slip**2 + (residual / time_s) ** 2 + speed * speed * tracks[:, YAW_VARIANCE]
    variance += free.take(classes_of(tracks))
    return (1j * heading).view(np.float64).reshape(len(tracks), 2), variance


def predicted(states: ObjectStates, dt: float) -> ObjectStates:
    """n objects `dt` s later, or earlier if negative, at constant velocity.

    Their covariances grow as in the box tracker, by white acceleration of their class (Bar-Shalom, Li, Kirubarajan
    2001, section 6.2.2), in either direction of time.
    """
    if len(states) == 0 or dt == 0.0:
        return states
    noise = process_noise(abs(dt), ACCELERATION[states.class_id], VERTICAL_ACCELERATION, SIZE_DRIFT)
    moved = propagate(states, dt)
    return moved.with_(covariance=moved.covariance + noise)


#: m^2, (m/s)^2: limits on variances; the least corresponds to 1 cm, the largest prevents overflow.
MIN_VARIANCE = 1e-4
MAX_VARIANCE = 1e8


def make_positive_definite(covariance: Floats) -> Floats:
    """Make finite matrices (n, k, k) symmetric and positive definite.

    If all are already valid, they are returned symmetrised; otherwise their eigenvalues are limited to between
    MIN_VARIANCE and MAX_VARIANCE.
    """
    symmetric, valid = symmetrise(covariance, MIN_VARIANCE, MAX_VARIANCE)
    if valid:
        return symmetric
    values, vectors = np.linalg.eigh(np.clip(symmetric, -MAX_VARIANCE, MAX_VARIANCE))
    repaired = (vectors * np.clip(values, MIN_VARIANCE, MAX_VARIANCE)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.asarray(0.5 * (repaired + repaired.transpose(0, 2, 1)))


@kernel
def symmetrise(covariance: Floats, min_variance: float, max_variance: float) -> tuple[Floats, bool]:
    """Symmetric parts (n, k, k), k up to 9; and whether all are within the limits."""
    symmetric = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    n, k = covariance.shape[:2]
    shifted = symmetric.reshape(n, k * k).copy()
    diagonal = shifted[:, :: k + 1]
    too_large = n > 0 and diagonal.max() > max_variance
    diagonal -= 0.5 * min_variance
    return symmetric, n == 0 or (not too_large and _definite(shifted.reshape(n, k, k)))


def _definite(matrices: Floats) -> bool:
    """Whether all (n, k, k) are positive definite."""
    try:
        np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        return False
    return True


#: Indices into the 81 numbers of a covariance: horizontal motion [x y vx vy], height and its rate, sizes. A tracker in
#: the world frame has no correlations between these blocks.
_HORIZONTAL = (9 * np.array([0, 1, 6, 7])[:, None] + np.array([0, 1, 6, 7])).ravel()
_Z, _Z_RATE, _RATE = 20, 26, 80
_SIZES = slice(30, 51, 10)
_COUPLING = np.ones(81, bool)
_COUPLING[_HORIZONTAL] = _COUPLING[[_Z, _Z_RATE, 74, _RATE]] = _COUPLING[_SIZES] = False
_COUPLING = _COUPLING.nonzero()[0]


def inverse(covariance: Floats) -> Floats:
    """Inverses (n, 9, 9) of symmetric, positive definite matrices.

    Block by block if the blocks are uncorrelated.
    """
    n = len(covariance)
    flat = covariance.reshape(n, 81)
    if flat.take(_COUPLING, 1).any():
        return np.asarray(np.linalg.inv(covariance))
    result = np.zeros((n, 81))
    result[:, _HORIZONTAL] = np.linalg.inv(flat.take(_HORIZONTAL, 1).reshape(n, 4, 4)).reshape(n, 16)
    result[:, _SIZES] = 1.0 / flat[:, _SIZES]
    a, b, c = flat[:, _Z], flat[:, _Z_RATE], flat[:, _RATE]
    scale = 1.0 / (a * c - b * b)
    result[:, _Z], result[:, _RATE] = c * scale, a * scale
    result[:, _Z_RATE] = result[:, 74] = -b * scale
    return result.reshape(n, 9, 9)
