"""One box for each cluster of a batch, whatever the order of its rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats
from mast_zenoh.integrity.base import Batch

#: m², side of a car that a sensor sees least of: width times height.
_CAR_M2 = 1.8 * 1.5


@dataclass(frozen=True, slots=True, eq=False)
class ClusterBoxes:
    """Mean boxes of c clusters, world frame.

    position: (c, 3) m, velocity: (c, 3) m/s, size: (c, 3) m, yaw: (c,) rad, of the length axis, in either direction

    A member shifts the mean of two by half its error, which the clusterer's radius limits.
    """

    position: Floats
    velocity: Floats
    size: Floats
    yaw: Floats

    @classmethod
    def of(cls, batch: Batch, use: Bools | None = None) -> ClusterBoxes:
        """The mean boxes of the clusters of a batch.

        use: (c, a) which agents' tracks count; None: all. A cluster without any has the mean of all.
        """
        states = batch.states
        present: Bools = batch.reported
        if use is not None:
            used = present & use
            present = np.asarray(np.where(used.any(axis=1, keepdims=True), used, present), np.bool_)
        count = present.sum(axis=1)

        def mean(values: Floats) -> Floats:
            # Summed by agent, so that rounding does not depend on the order of the rows.
            table = np.where(present[..., None], values[batch.member], 0.0)
            return np.asarray(table.sum(axis=1) / count[:, None])

        def median(values: Floats) -> Floats:
            ordered = np.sort(np.where(present[..., None], values[batch.member], np.inf), axis=1)
            low, high = ((count - 1) // 2)[:, None, None], (count // 2)[:, None, None]
            middle = np.take_along_axis(ordered, low, axis=1) + np.take_along_axis(ordered, high, axis=1)
            return np.asarray(0.5 * middle[:, 0])

        double = mean(np.column_stack([np.cos(2.0 * states.yaw), np.sin(2.0 * states.yaw)]))
        return cls(
            position=median(states.position),
            velocity=median(states.velocity),
            size=median(states.size),
            yaw=0.5 * np.arctan2(double[:, 1], double[:, 0]),
        )

    def sight_range(self, range_m: float) -> Floats:
        """(c,) m up to which a box gives a lidar as many returns as a car does at `range_m`, at most `range_m`.

        The number of returns goes with the area of the smaller side over the squared distance.
        """
        area = np.minimum(self.size[:, 0], self.size[:, 1]) * self.size[:, 2]
        return np.asarray(range_m * np.sqrt(np.clip(area / _CAR_M2, 0.0, 1.0)))
