"""Gating: candidate pairs of tracks and measurements, and their likelihoods."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.tracks import ODDS, XX, XY, YY, classes_of, planar

#: Limits of the squared Mahalanobis distance in the plane: for steady motion, exceeded by a true pair with probability
#: 3e-4; and with a sudden displacement.
GATE, SUDDEN_GATE = 16.0, 8.0

LOG_2_PI = math.log(2.0 * math.pi)

#: m, difference in height beyond which two objects are on different levels of a road.
LEVEL_M = 3.0

#: Fraction of the displacement variance for an object at rest, and its increase per (m/s)^2; it reaches 1 at 5 m/s.
STANDING, MOVING = 0.1, 0.9 / 5.0**2

_HORIZONTAL = np.array([XX, XY, YY])
_NONE = np.zeros(0, np.int64)


class Pairs(NamedTuple):
    """p gated pairs of a track and a measurement.

    track, measurement: (p,) rows
    log_density: (p,) ln of the density, per m^2, of the measurement's horizontal position given the track
    jump: (p,) m^2, variance per axis added by a sudden displacement, 0 if steady motion explains the pair
    """

    track: Ints
    measurement: Ints
    log_density: Floats
    jump: Floats


def near_pairs(tracks: Floats, position: Floats, covariance: Floats, jump: Floats, jump_probability: float) -> Pairs:
    """The pairs of n tracks and m measurements within the gate, in the order of tracks, then measurements.

    position: (m, >= 3) m; covariance: (m, k, k), the first two rows and columns are x and y, m^2
    jump: (n,) m^2, variance per axis of a sudden displacement of a moving object, which occurs in a frame with
        `jump_probability`

    Boxes do jump: their centre shifts as more of an object comes into view, and simulated traffic changes lanes within
    a step. Jumps are considered only for tracks and measurements without a pair under steady motion. Objects at rest
    do not change lanes.
    """
    if len(tracks) == 0 or len(position) == 0:
        return Pairs(_NONE, _NONE, np.zeros(0), np.zeros(0))
    near = neighbours(tracks, position, reach(tracks, covariance, jump, GATE))
    gates, moving, log_jump = (GATE, SUDDEN_GATE), (STANDING, MOVING), math.log(jump_probability)
    return Pairs(*gated(tracks, position, covariance, jump, *near, gates, LEVEL_M, moving, log_jump))


@kernel
def reach(tracks: Floats, covariance: Floats, jump: Floats, gate: float) -> Floats:
    """(n,) m beyond which no measurement can be within the gate of a track."""
    # The trace bounds the largest eigenvalue, which gives a cheap circle around both ellipses for all pairs.
    widest = (covariance[:, 0, 0] + covariance[:, 1, 1]).max()
    return np.asarray(np.sqrt(gate * (tracks[:, XX] + tracks[:, YY] + 0.5 * jump + widest)))


@kernel
def gated(
    tracks: Floats,
    position: Floats,
    covariance: Floats,
    jump: Floats,
    i: Ints,
    j: Ints,
    dx: Floats,
    dy: Floats,
    gates: tuple[float, float],
    level_m: float,
    moving: tuple[float, float],
    log_jump: float,
) -> tuple[Ints, Ints, Floats, Floats]:
    """The fields of `Pairs` for those of p pairs (i, j) within the gate; (dx, dy): measurement relative to track.

    gates: GATE, SUDDEN_GATE; moving: STANDING, MOVING; log_jump: ln of the probability of a sudden displacement
    """
    gate, sudden_gate = gates
    track_variance = tracks.take(_HORIZONTAL, 1)
    k = covariance.shape[1]
    measured_variance = covariance.reshape(len(position), k * k).take((0, 1, k + 1), 1)
    level = np.abs(position[:, 2].take(j) - tracks[:, 2].take(i)) <= level_m
    total = track_variance.take(i, 0) + measured_variance.take(j, 0)
    a, b, c = total[:, 0], total[:, 1], total[:, 2]
    log_density, distance = _gaussian(dx, dy, a, b, c)
    selected = (distance <= gate) & level
    added = np.zeros(len(i))
    alone, unexplained = np.ones(len(tracks), bool), np.ones(len(position), bool)
    alone[i[selected]] = unexplained[j[selected]] = False
    far = (level & alone[i] & unexplained[j]).nonzero()[0]
    if len(far):
        speed = np.abs(planar(tracks[i[far], 6:8]))
        jump_variance = jump[i[far]] * np.minimum(moving[0] + moving[1] * speed * speed, 1.0)
        density, distance = _gaussian(dx[far], dy[far], a[far] + jump_variance, b[far], c[far] + jump_variance)
        log_density[far] = density + log_jump
        added[far] = jump_variance
        selected[far] = distance <= sudden_gate
    return i[selected], j[selected], log_density[selected], added[selected]


@kernel
def gains(
    tracks: Floats,
    detected: Floats,
    class_id: Ints,
    confusion: Floats,
    i: Ints,
    j: Ints,
    log_density: Floats,
    log_clutter: float,
) -> tuple[Floats, Floats]:
    """(p,) for pairs (i, j): log likelihood ratio to clutter; and the gain of choosing the pair.

    The gain is relative to leaving both unassigned: the object was missed or is absent, the measurement is clutter.
    detected: (n,) probability of detection; class_id: (m,) measured; confusion: see `classes`
    """
    ratio = log_density - log_clutter + confusion[classes_of(tracks)[i], class_id[j]]
    odds = tracks[:, ODDS]
    return ratio, ratio + np.log(detected * odds / ((1.0 - detected) * (1.0 + odds)))[i]


def _gaussian(dx: Floats, dy: Floats, a: Floats, b: Floats, c: Floats) -> tuple[Floats, Floats]:
    """Log densities at (dx, dy) of normal distributions of covariance [[a, b], [b, c]]; squared distances."""
    slope = b / a
    conditional = c - b * slope
    dy = dy - slope * dx
    distance = dx * dx / a + dy * dy / conditional
    return -0.5 * (distance + np.log(a * conditional)) - LOG_2_PI, distance
