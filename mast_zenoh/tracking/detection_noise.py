"""The noise of detections without covariances, estimated from innovations."""

from __future__ import annotations

import math

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.tracking.tracks import CONFIRMED, XX, YY

#: Number of pairs over which the estimate averages, and weight of the default in pairs.
MEMORY, PRIOR = 1000.0, 200.0
#: Ratio to the default variance up to which the default is used: half as much again in standard deviation.
TOLERANCE = 1.5**2
#: Largest ratio to the default variance.
LARGEST = 5.0**2


class DetectionNoise:
    """Variances of the detections of one source that gives no covariances.

    The mean squared innovation of a filter is the variance of its prediction plus that of the measurement, so their
    difference estimates the latter (covariance matching: Mehra, IEEE Transactions on Automatic Control, 1972). Only the
    horizontal position is estimated, the same for both axes.

    The default is kept to the bit while the estimate is near or below it: errors that last are in the tracks too, and
    their innovations are too small. Above, the estimate is used, up to a limit.

    variance: (6,) m^2, of x y z l w h, currently used
    """

    def __init__(self, default: Floats) -> None:
        self._default = self.variance = default
        self._sum, self._weight = PRIOR * float(default[0]), PRIOR

    def learn(self, tracks: Floats, innovation: Floats, steady: Bools) -> None:
        """Learn from k matched pairs.

        tracks: (k, WIDTH), predicted; innovation: (k, 2) m; steady: (k,) whether steady motion explains the pair

        Only confirmed tracks count: the velocity of new ones is not known yet.
        """
        rows = (steady & (tracks[:, CONFIRMED] > 0.0)).nonzero()[0]
        if len(rows) == 0:
            return
        innovation, t = innovation.take(rows, 0), tracks.take(rows, 0)
        excess = 0.5 * float(np.einsum("ij,ij->", innovation, innovation) - t[:, XX].sum() - t[:, YY].sum())
        keep = math.exp(-len(rows) / MEMORY)
        self._sum, self._weight = max(keep * self._sum + excess, 0.0), keep * self._weight + len(rows)
        ratio = self._sum / (self._weight * float(self._default[0]))
        self.variance = self._default
        if ratio > TOLERANCE:
            self.variance = self._default.copy()
            self.variance[:2] *= min(ratio, LARGEST)
