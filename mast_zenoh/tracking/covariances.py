"""Covariances of full states: repair of those from other sources, and fast inverses."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.kernels import kernel

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
