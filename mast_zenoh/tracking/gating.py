"""Which measurement may belong to which track, and how likely."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mast_zenoh.states import Floats, Ints
from mast_zenoh.tracking.neighbours import neighbours
from mast_zenoh.tracking.tracks import XX, XY, YY, planar

#: Squared Mahalanobis distance in the plane beyond which steady motion does not explain a pair: probability 3e-4 of a
#: true one; and what a sudden displacement may explain.
GATE, SUDDEN_GATE = 16.0, 8.0

LOG_2_PI = math.log(2.0 * math.pi)

#: m, difference in height beyond which two things are on different levels of a road.
LEVEL_M = 3.0

#: Share of a sudden displacement's variance that what stands has, and what each (m/s)^2 adds: all of it from 5 m/s on.
STANDING, MOVING = 0.1, 0.9 / 5.0**2

_HORIZONTAL = np.array([XX, XY, YY])
_NONE = np.zeros(0, np.int64)


class Pairs(NamedTuple):
    """p pairs of a track and a measurement that lie near each other.

    track, measurement: (p,) rows
    log_density: (p,) ln of the density, per m^2, of the measurement's horizontal position if it is of the track
    jump: (p,) m^2, variance that a sudden displacement adds per axis, 0 where steady motion explains the pair
    """

    track: Ints
    measurement: Ints
    log_density: Floats
    jump: Floats


def near_pairs(tracks: Floats, position: Floats, covariance: Floats, jump: Floats, jump_probability: float) -> Pairs:
    """The pairs of n tracks and m measurements within the gate, in the order of tracks, then measurements.

    position: (m, >= 3) m; covariance: (m, k, k), the first two rows and columns are x and y, m^2
    jump: (n,) m^2, variance per axis of a sudden displacement of a moving object, which has `jump_probability` in a
        frame

    Boxes do jump: their centre shifts as more of an object comes into view, and simulated traffic changes lanes within
    a step. That is considered for tracks and measurements that steady motion leaves alone. What stands does not change
    lanes.
    """
    n, m = len(tracks), len(position)
    if n == 0 or m == 0:
        return Pairs(_NONE, _NONE, np.zeros(0), np.zeros(0))
    own = tracks.take(_HORIZONTAL, 1)
    k = covariance.shape[1]
    measured = covariance.reshape(m, k * k).take((0, 1, k + 1), 1)
    # The trace bounds the largest eigenvalue: a cheap circle round both ellipses, for all pairs.
    reach = own[:, 0] + own[:, 2] + 0.5 * jump + (measured[:, 0] + measured[:, 2]).max()
    i, j, dx, dy = neighbours(tracks, position, np.sqrt(GATE * reach))
    level = np.abs(position[:, 2].take(j) - tracks[:, 2].take(i)) <= LEVEL_M
    total = own.take(i, 0) + measured.take(j, 0)
    a, b, c = total[:, 0], total[:, 1], total[:, 2]
    log_density, distance = _gaussian(dx, dy, a, b, c)
    near = (distance <= GATE) & level
    added = np.zeros(len(i))
    alone, unexplained = np.ones(n, bool), np.ones(m, bool)
    alone[i[near]] = unexplained[j[near]] = False
    far = (level & alone[i] & unexplained[j]).nonzero()[0]
    if len(far):
        speed = np.abs(planar(tracks[i[far], 6:8]))
        more = jump[i[far]] * np.minimum(STANDING + MOVING * speed * speed, 1.0)
        density, distance = _gaussian(dx[far], dy[far], a[far] + more, b[far], c[far] + more)
        log_density[far] = density + math.log(jump_probability)
        added[far] = more
        near[far] = distance <= SUDDEN_GATE
    if not near.all():
        i, j, log_density, added = i[near], j[near], log_density[near], added[near]
    return Pairs(i, j, log_density, added)


def _gaussian(dx: Floats, dy: Floats, a: Floats, b: Floats, c: Floats) -> tuple[Floats, Floats]:
    """ln of the densities at (dx, dy) of normal distributions of covariance [[a, b], [b, c]]; squared distances."""
    slope = b / a
    rest = c - b * slope
    dy = dy - slope * dx
    distance = dx * dx / a + dy * dy / rest
    return -0.5 * (distance + np.log(a * rest)) - LOG_2_PI, distance
