"""Covariances from outside, made fit for use: a filter must outlive whatever a source says of its own uncertainty."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats
from mast_zenoh.kernels import kernel

#: m^2, (m/s)^2: no source knows anything better than this (1 cm), nor is so ignorant that numbers overflow.
LEAST = 1e-4
MOST = 1e8


def sound(covariance: Floats) -> Floats:
    """(n, k, k) symmetric and positive definite, from any finite (n, k, k).

    What is so comes back as it was; of the rest the symmetric part, eigenvalues brought to within LEAST and MOST.
    """
    symmetric, fit = symmetrised(covariance, LEAST, MOST)
    if fit:
        return symmetric
    values, vectors = np.linalg.eigh(np.clip(symmetric, -MOST, MOST))
    repaired = (vectors * np.clip(values, LEAST, MOST)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.asarray(0.5 * (repaired + repaired.transpose(0, 2, 1)))


@kernel
def symmetrised(covariance: Floats, least: float, most: float) -> tuple[Floats, bool]:
    """Symmetric parts (n, k, k), k up to 9; and whether all of them may stay as they are."""
    symmetric = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    n, k = covariance.shape[:2]
    shifted = symmetric.reshape(n, k * k).copy()
    diagonal = shifted[:, :: k + 1]
    too_much = n > 0 and diagonal.max() > most
    diagonal -= 0.5 * least
    return symmetric, n == 0 or (not too_much and _definite(shifted.reshape(n, k, k)))


def _definite(matrices: Floats) -> bool:
    """Whether all (n, k, k) are positive definite."""
    try:
        np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        return False
    return True
