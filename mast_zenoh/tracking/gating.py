"""Which measurement may belong to which track, and how likely."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mast_zenoh.states import Floats, Ints
from mast_zenoh.tracking.tracks import Tracks

#: Squared Mahalanobis distances in the plane beyond which nothing is considered: probability 3e-4 of a true pair.
GATE = 16.0

LOG_2_PI = math.log(2.0 * math.pi)

#: m, difference in height beyond which two things are on different levels of a road.
LEVEL_M = 3.0


@dataclass(frozen=True, slots=True)
class Pairs:
    """p pairs of a track and a measurement that lie near each other.

    track, measurement: (p,) rows
    log_density: (p,) ln of the density, per m^2, of the measurement's horizontal position if it is of the track
    jump: (p,) m^2, variance that a sudden displacement adds per axis, 0 where steady motion explains the pair better
    """

    track: Ints
    measurement: Ints
    log_density: Floats
    jump: Floats


def near_pairs(tracks: Tracks, position: Floats, covariance: Floats, jump: Floats, jump_probability: float) -> Pairs:
    """The pairs of n tracks and m measurements within the gate, in the order of tracks, then measurements.

    position: (m, 3) m; covariance: (m, k, k), the first two rows and columns are x and y, m^2
    jump: (n,) m, standard deviation per axis of a sudden displacement, which has `jump_probability` in a frame

    The density is a mixture: motion as predicted, or a sudden displacement on top. Boxes do jump: their centre shifts
    as more of an object comes into view, and simulated traffic changes lanes within a step.
    """
    mean, P = tracks["mean"], tracks["covariance"]
    if len(tracks) == 0 or len(position) == 0:
        none = np.zeros(0, np.int64)
        return Pairs(none, none, np.zeros(0), np.zeros(0))
    x, y = mean[:, 0], mean[:, 1]
    xx, xy, yy = P[:, 0, 0], P[:, 0, 1], P[:, 1, 1]
    measured_xx, measured_xy, measured_yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    # The trace bounds the largest eigenvalue: a cheap circle round the ellipse, for all pairs.
    displaced = jump * jump
    steady_reach = GATE * (xx + yy + (measured_xx + measured_yy).max())
    reach = np.maximum(steady_reach, 0.5 * steady_reach + GATE * displaced)
    dx = position[:, 0] - x[:, None]
    dy = position[:, 1] - y[:, None]
    i, j = (dx * dx + dy * dy <= reach[:, None]).nonzero()
    dx, dy = dx[i, j], dy[i, j]
    # Two rows: steady motion, and a sudden displacement on top.
    added = np.zeros((2, len(i)))
    added[1] = displaced[i]
    a = xx[i] + measured_xx[j] + added
    b = xy[i] + measured_xy[j]
    c = yy[i] + measured_yy[j] + added
    determinant = a * c - b * b
    distance = (c * dx * dx - 2.0 * b * dx * dy + a * dy * dy) / determinant
    steady, sudden = -0.5 * (distance + np.log(determinant)) - LOG_2_PI
    steady += math.log1p(-jump_probability)
    sudden += math.log(jump_probability)
    near = (distance[0] <= GATE) | (distance[1] <= 0.5 * GATE)
    near &= np.abs(position[:, 2][j] - mean[:, 2][i]) <= LEVEL_M
    variance = np.where(sudden > steady, added[1], 0.0)
    return Pairs(i[near], j[near], np.logaddexp(steady, sudden)[near], variance[near])
