"""Gating: candidate pairs of tracks and measurements, and their likelihoods."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.measured import Measured
from mast_zenoh.tracking.tracks import ODDS, XX, XY, YY, classes_of, planar

LOG_2_PI = math.log(2.0 * math.pi)


class Gate(NamedTuple):
    """Limits on possible pairs of a track and a measurement.

    steady: squared Mahalanobis distance in the plane up to which steady motion explains a pair; a true pair exceeds it
            with probability 3e-4
    sudden: the same for a sudden displacement
    level_m: m, difference in height above which two objects are on different levels of a road
    standing, moving: fraction of a sudden displacement's variance for an object at rest, and the increase per (m/s)^2;
            reaches 1 at 5 m/s
    """

    steady: float = 16.0
    sudden: float = 8.0
    level_m: float = 3.0
    standing: float = 0.1
    moving: float = 0.9 / 5.0**2


GATE = Gate()

_HORIZONTAL = np.array([XX, XY, YY])
_NONE = np.zeros(0, np.int64)


class AssociationModel(NamedTuple):
    """What gating assumes of jumps, clutter and confused classes.

    jump: (classes,) m^2, variance per axis of a sudden displacement of a moving object
    log_jump: ln of the probability of a sudden displacement in a frame
    log_clutter: ln of the density of false detections, per m^2
    confusion: (classes, classes) log-likelihoods, see `classes`
    """

    jump: Floats
    log_jump: float
    log_clutter: float
    confusion: Floats


class Pairs(NamedTuple):
    """p gated pairs of a track and a measurement.

    track, measurement: (p,) rows
    log_ratio: (p,) ln of the density of the measurement's horizontal position given the track, over that of clutter
    jump: (p,) m^2, variance per axis added by a sudden displacement, 0 if steady motion explains the pair
    cost: (p,) of choosing the pair, relative to leaving both unassigned: the object was missed or is absent, the
        measurement is clutter
    """

    track: Ints
    measurement: Ints
    log_ratio: Floats
    jump: Floats
    cost: Floats


def near_pairs(tracks: Floats, detected: Floats, measured: Measured, model: AssociationModel) -> Pairs:
    """Pairs of n tracks and m measurements within the gate, sorted by track.

    detected: (n,) probability of detection

    Boxes do jump: their centre shifts as more of an object comes into view, and simulated traffic changes lanes within
    a step. Jumps are considered only for tracks and measurements without a pair under steady motion. Objects at rest
    do not change lanes.
    """
    if len(tracks) == 0 or len(measured.row) == 0:
        return Pairs(_NONE, _NONE, np.zeros(0), np.zeros(0), np.zeros(0))
    near = neighbours(tracks, measured.state, gate_radius(tracks, measured.noise, model.jump, GATE.steady))
    boxes = measured.state, measured.noise, measured.class_id
    return Pairs(*gated_pairs(tracks, detected, boxes, near, GATE, model))


@kernel
def gate_radius(tracks: Floats, covariance: Floats, jump: Floats, gate: float) -> Floats:
    """Radius (n,) m around each track that contains all measurements within its gate.

    covariance: (m, k, k) of the measurements; jump: see `AssociationModel`
    """
    # The trace bounds the largest eigenvalue, which gives a cheap circle around both ellipses for all pairs.
    widest = (covariance[:, 0, 0] + covariance[:, 1, 1]).max()
    added = 0.5 * jump.take(classes_of(tracks))
    return np.asarray(np.sqrt(gate * (tracks[:, XX] + tracks[:, YY] + added + widest)))


@kernel
def gated_pairs(
    tracks: Floats,
    detected: Floats,
    boxes: tuple[Floats, Floats, Ints],
    near: tuple[Ints, Ints, Floats, Floats],
    gate: Gate,
    model: AssociationModel,
) -> tuple[Ints, Ints, Floats, Floats, Floats]:
    """Select p candidate pairs within the gate; the result are the fields of `Pairs`.

    boxes: `state`, `noise` and `class_id` of `Measured`
    near: (p,) rows of tracks and of measurements, and offsets in x and y from track to measurement, m
    """
    i, j, dx, dy = near
    position, covariance, class_id = boxes
    track_variance = tracks.take(_HORIZONTAL, 1)
    k = covariance.shape[1]
    measured_variance = covariance.reshape(len(position), k * k).take((0, 1, k + 1), 1)
    level = np.abs(position[:, 2].take(j) - tracks[:, 2].take(i)) <= gate.level_m
    total = track_variance.take(i, 0) + measured_variance.take(j, 0)
    a, b, c = total[:, 0], total[:, 1], total[:, 2]
    log_density, distance = gaussian(dx, dy, a, b, c)
    selected = (distance <= gate.steady) & level
    added = np.zeros(len(i))
    alone, unexplained = np.ones(len(tracks), bool), np.ones(len(position), bool)
    alone[i[selected]] = unexplained[j[selected]] = False
    far = (level & alone[i] & unexplained[j]).nonzero()[0]
    if len(far):
        speed = np.abs(planar(tracks[i[far], 6:8]))
        jump = model.jump.take(classes_of(tracks)[i[far]])
        jump_variance = jump * np.minimum(gate.standing + gate.moving * speed * speed, 1.0)
        density, distance = gaussian(dx[far], dy[far], a[far] + jump_variance, b[far], c[far] + jump_variance)
        log_density[far] = density + model.log_jump
        added[far] = jump_variance
        selected[far] = distance <= gate.sudden
    i, j = i[selected], j[selected]
    ratio = log_density[selected] - model.log_clutter + model.confusion[classes_of(tracks)[i], class_id[j]]
    odds = tracks[:, ODDS]
    gain = ratio + np.log(detected * odds / ((1.0 - detected) * (1.0 + odds)))[i]
    return i, j, ratio, added[selected], -gain


def gaussian(dx: Floats, dy: Floats, a: Floats, b: Floats, c: Floats) -> tuple[Floats, Floats]:
    """Log densities of zero-mean Gaussians at (dx, dy), and squared distances.

    The covariance is [[a, b], [b, c]].
    """
    slope = b / a
    conditional = c - b * slope
    dy = dy - slope * dx
    distance = dx * dx / a + dy * dy / conditional
    return -0.5 * (distance + np.log(a * conditional)) - LOG_2_PI, distance


class Match(NamedTuple):
    """k matched tracks and measurements.

    log_ratio: (k,) log density ratios to clutter; jump: (k,) m^2, jump variances; near: all gated pairs

    contested: whether there are gated pairs that were not chosen
    """

    track: Ints
    measurement: Ints
    log_ratio: Floats
    jump: Floats
    near: Pairs
    contested: bool
