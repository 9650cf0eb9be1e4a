"""Association of measurements with tracks: their order, gates, likelihoods, and one-to-one assignment."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.matching import greedy_matching, min_cost_matching, neighbours, uncontested
from mast_zenoh.arrays.states import Bools, Detections, Floats, Ints, ObjectStates, row_order
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.kalman import MAX_VARIANCE, MIN_VARIANCE
from mast_zenoh.tracking.tracks import ODDS, XX, XY, YY, classes_of, known_class, planar


class MeasurementBatch(NamedTuple):
    """m measurements.

    row: (m,) int64, row in the input
    state: (m, 6) boxes x y z l w h, or (m, 9) with vx vy vz; noise: (m, k, k) their covariances
    yaw: (m,) rad; class_id: (m,) int64; score: (m,)
    """

    row: Ints
    state: Floats
    noise: Floats
    yaw: Floats
    class_id: Ints
    score: Floats

    @classmethod
    def detections(cls, d: Detections, variance: Floats) -> MeasurementBatch:
        """Measurements of boxes; variance: (6,) defaults for unspecified noise."""
        order = row_order(d.position[:, 0], ties=lambda: (d.score, d.class_id, *d.size.T, d.yaw, *d.position.T[:0:-1]))
        columns = d.position, d.size, d.yaw, d.class_id, d.score, d.covariance
        return cls(order, *ordered_boxes(order, columns, variance, MIN_VARIANCE, MAX_VARIANCE))

    @classmethod
    def states(cls, s: ObjectStates) -> MeasurementBatch:
        """Measurements of full states."""
        order = row_order(s.id, s.position[:, 0])
        state = np.concatenate([s.position, s.size, s.velocity], axis=1).take(order, 0)
        class_id = known_class(s.class_id.take(order))
        return cls(order, state, s.covariance.take(order, 0), s.yaw.take(order), class_id, s.score.take(order))


@kernel
def ordered_boxes(
    order: Ints, columns: tuple[Any, ...], variance: Floats, least: float, most: float
) -> tuple[Floats, Floats, Floats, Ints, Floats]:
    """The fields of `MeasurementBatch` of m boxes, except `row`: the rows `order` of n boxes.

    columns: position, size (n, 3) m, yaw (n,) rad, class_id (n,) uint8, score (n,) and position covariance (n, 3, 3)
        m^2, all zero if unknown
    variance: (6,) m^2, defaults; least, most: m^2, MIN_VARIANCE, MAX_VARIANCE
    """
    position, size, yaw, class_id, score, covariance = columns
    box = np.concatenate([position, size], axis=1).take(order, 0)
    noise = _box_noise(covariance, order, variance, least, most)
    return box, noise, yaw.take(order), known_class(class_id.take(order)), score.take(order)


def _box_noise(covariance: Floats, order: Ints, variance: Floats, least: float, most: float) -> Floats:
    """Noise covariances (m, 6, 6) of boxes in `order`.

    covariance: (m, 3, 3) m^2, reported position covariances, all zero if unknown
    variance: (6,) m^2, defaults; least, most: m^2, MIN_VARIANCE, MAX_VARIANCE

    Correlations between horizontal and vertical position are ignored. The result is positive definite for any input.
    """
    m = len(order)
    noise = np.zeros((m, 36))
    noise[:, ::7] = variance
    if covariance.any():
        reported = covariance.reshape(m, 9).take(order, 0)
        diagonal = reported[:, ::4]
        diagonal = np.minimum(np.maximum(np.where(diagonal > 0.0, diagonal, variance[:3]), least), most)
        noise[:, :15:7] = diagonal
        diagonal -= 0.5 * least
        bound = np.sqrt(diagonal[:, 0] * diagonal[:, 1])
        noise[:, 1] = noise[:, 6] = np.minimum(np.maximum(reported[:, 1], -bound), bound)
    return noise.reshape(m, 6, 6)


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


def near_pairs(tracks: Floats, detected: Floats, measured: MeasurementBatch, model: AssociationModel) -> Pairs:
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

    boxes: `state`, `noise` and `class_id` of `MeasurementBatch`
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


#: Largest number of rows times columns for an optimal assignment, whose run time grows with its power of 3/2.
MAX_PAIRS = 1_000_000


class Assignment(ABC):
    """Chooses pairs such that every row and every column is used at most once."""

    def match(self, row: Ints, column: Ints, cost: Floats) -> Ints:
        """(k,) int64, ascending: rows of the chosen pairs among p.

        row, column: (p,) int64 >= 0, no pair twice; cost: (p,), cost of choosing the pair relative to
        leaving both unassigned. Pairs with cost >= 0 are never chosen.
        """
        useful, chosen = useful_pairs(row, column, cost)
        contested_rows = (~chosen).nonzero()[0]
        if len(contested_rows) == 0:
            return useful
        contested = useful[contested_rows]
        chosen[contested_rows] = self._choose(row[contested], column[contested], cost[contested])
        matches: Ints = useful[chosen]
        return matches

    @abstractmethod
    def _choose(self, row: Ints, column: Ints, cost: Floats) -> Bools:
        """(p,) bool: which of p contested pairs with negative cost to choose."""


@kernel
def useful_pairs(row: Ints, column: Ints, cost: Floats) -> tuple[Ints, Bools]:
    """Pairs (k,) with negative cost, and which of them (k,) are uncontested.

    The indices are ascending. Uncontested pairs share no row or column; most pairs are, and they are always chosen.
    """
    useful: Ints = (cost < 0.0).nonzero()[0]
    return useful, uncontested(row[useful], column[useful])


class BipartiteAssignment(Assignment):
    """Minimises the total cost, see `matching.min_cost_matching`.

    Falls back to greedy assignment above MAX_PAIRS possible pairs; only a hostile source sends so many.
    """

    def _choose(self, row: Ints, column: Ints, cost: Floats) -> Bools:
        if _count_distinct(row) * _count_distinct(column) > MAX_PAIRS:
            return greedy_matching(row, column, cost)
        return min_cost_matching(row, column, cost)


class GreedyAssignment(Assignment):
    """Chooses the cheapest pair first, see `matching.greedy_matching`."""

    def _choose(self, row: Ints, column: Ints, cost: Floats) -> Bools:
        return greedy_matching(row, column, cost)


def _count_distinct(values: Ints) -> int:
    """Number of distinct values; values >= 0."""
    return int(np.count_nonzero(np.bincount(values)))
