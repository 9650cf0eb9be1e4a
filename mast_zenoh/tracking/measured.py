"""Measurements for a tracker, in an order independent of their arrival."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mast_zenoh.arrays.ordering import row_order
from mast_zenoh.arrays.states import Detections, Floats, Ints, ObjectStates
from mast_zenoh.kernels import kernel
from mast_zenoh.tracking.covariance_repair import MAX_VARIANCE, MIN_VARIANCE
from mast_zenoh.tracking.tracks import known_class


class Measured(NamedTuple):
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
    def detections(cls, d: Detections, variance: Floats) -> Measured:
        """Measurements of boxes; variance: (6,) defaults for unspecified noise."""
        order = row_order(d.position[:, 0], ties=lambda: (d.score, d.class_id, *d.size.T, d.yaw, *d.position.T[:0:-1]))
        columns = d.position, d.size, d.yaw, d.class_id, d.score, d.covariance
        return cls(order, *ordered_boxes(order, columns, variance, MIN_VARIANCE, MAX_VARIANCE))

    @classmethod
    def states(cls, s: ObjectStates) -> Measured:
        """Measurements of full states."""
        order = row_order(s.id, s.position[:, 0])
        state = np.concatenate([s.position, s.size, s.velocity], axis=1).take(order, 0)
        class_id = known_class(s.class_id.take(order))
        return cls(order, state, s.covariance.take(order, 0), s.yaw.take(order), class_id, s.score.take(order))


@kernel
def ordered_boxes(
    order: Ints, columns: tuple[Any, ...], variance: Floats, least: float, most: float
) -> tuple[Floats, Floats, Floats, Ints, Floats]:
    """The fields of `Measured` of m boxes, except `row`: the rows `order` of n boxes.

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
