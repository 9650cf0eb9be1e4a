"""What a tracker takes in, in an order that does not depend on how it came."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mast_zenoh.arrays.ordering import row_order
from mast_zenoh.arrays.states import Detections, Floats, Ints, ObjectStates
from mast_zenoh.tracking.soundness import LEAST, MOST
from mast_zenoh.tracking.tracks import known_class


class Measured(NamedTuple):
    """m measurements.

    row: (m,) int64, where each was in the input
    state: (m, 6) boxes x y z l w h, or (m, 9) with vx vy vz; noise: (m, k, k) their covariances
    yaw: (m,) rad; class_id: (m,) int64
    """

    row: Ints
    state: Floats
    noise: Floats
    yaw: Floats
    class_id: Ints

    @classmethod
    def detections(cls, d: Detections, variance: Floats) -> Measured:
        """Boxes; `variance`: (6,) of what a detection says nothing about."""
        x, y, z = d.position.T
        order = row_order(x, ties=(d.score, d.class_id, *d.size.T, d.yaw, z, y))
        box = np.concatenate([d.position, d.size], axis=1).take(order, 0)
        noise = box_noise(d.covariance, order, variance, LEAST, MOST)
        return cls(order, box, noise, d.yaw.take(order), known_class(d.class_id.take(order)))

    @classmethod
    def states(cls, s: ObjectStates) -> Measured:
        """Full states."""
        order = row_order(s.id, s.position[:, 0])
        state = np.concatenate([s.position, s.size, s.velocity], axis=1).take(order, 0)
        return cls(order, state, s.covariance.take(order, 0), s.yaw.take(order), known_class(s.class_id.take(order)))


def box_noise(covariance: Floats, order: Ints, variance: Floats, least: float, most: float) -> Floats:
    """(m, 6, 6) of boxes in `order`: of the position what the detector says (m, 3, 3), if it does.

    variance: (6,) m^2, of what it does not; least, most: m^2, LEAST, MOST

    Of the position the horizontal part and the vertical one: what they have in common says nothing on a road. Whatever
    the numbers, the result is positive definite.
    """
    m = len(order)
    noise = np.zeros((m, 36))
    noise[:, ::7] = variance
    if covariance.any():
        said = covariance.reshape(m, 9).take(order, 0)
        own = said[:, ::4]
        own = np.minimum(np.maximum(np.where(own > 0.0, own, variance[:3]), least), most)
        noise[:, :15:7] = own
        own -= 0.5 * least
        bound = np.sqrt(own[:, 0] * own[:, 1])
        noise[:, 1] = noise[:, 6] = np.minimum(np.maximum(said[:, 1], -bound), bound)
    return noise.reshape(m, 6, 6)
