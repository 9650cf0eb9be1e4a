"""Repair of covariances from other sources, so that a filter survives any input."""

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
