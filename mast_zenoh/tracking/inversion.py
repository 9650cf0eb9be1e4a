"""Fast inverses of full-state covariances."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats

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
