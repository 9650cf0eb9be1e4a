"""The noise of detections without covariances, estimated from innovations."""

from __future__ import annotations

import math

from mast_zenoh.arrays.states import Floats

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

    def learn(self, excess: float, count: int) -> None:
        """Learn from `count` matched pairs; excess: m^2, see `matched.excess_sum`."""
        if count == 0:
            return
        keep = math.exp(-count / MEMORY)
        self._sum, self._weight = max(keep * self._sum + 0.5 * excess, 0.0), keep * self._weight + count
        ratio = self._sum / (self._weight * float(self._default[0]))
        self.variance = self._default
        if ratio > TOLERANCE:
            self.variance = self._default.copy()
            self.variance[:2] *= min(ratio, LARGEST)
