"""One box for each cluster of a batch, whatever the order of its rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints
from mast_zenoh.integrity.base import Batch
from mast_zenoh.kernels import kernel

#: m², side of a car that a sensor sees least of: width times height.
_CAR_M2 = 1.8 * 1.5


@dataclass(frozen=True, slots=True, eq=False)
class ClusterBoxes:
    """Median boxes of `c` clusters (circular mean of the axes), world frame.

    position: (c, 3) m, velocity: (c, 3) m/s, size: (c, 3) m, yaw: (c,) rad, of the length axis, in either direction

    A member shifts the mean of two by half its error, which the clusterer's radius limits.
    """

    position: Floats
    velocity: Floats
    size: Floats
    yaw: Floats

    @classmethod
    def of(cls, batch: Batch, use: Bools | None = None) -> ClusterBoxes:
        """The median boxes of the clusters of a batch.

        use: (c, a) which agents' tracks count; None: all. A cluster without any uses all its members.
        """
        states = batch.states
        present: Bools = batch.reported
        if use is not None:
            used = present & use
            present = np.asarray(np.where(used.any(axis=1, keepdims=True), used, present), np.bool_)
        return cls(*median_boxes(states.position, states.velocity, states.size, states.yaw, batch.member, present))

    def sight_range(self, range_m: float) -> Floats:
        """(c,) m up to which a box gives a lidar as many returns as a car does at `range_m`, at most `range_m`.

        The number of returns goes with the area of the smaller side over the squared distance.
        """
        area = np.minimum(self.size[:, 0], self.size[:, 1]) * self.size[:, 2]
        return np.asarray(range_m * np.sqrt(np.clip(area / _CAR_M2, 0.0, 1.0)))


@kernel
def median_boxes(
    position: Floats, velocity: Floats, size: Floats, yaw: Floats, member: Ints, present: Bools
) -> tuple[Floats, Floats, Floats, Floats]:
    """Medians of the positions, velocities and sizes (c, 3) of the members of c clusters, and their mean yaws (c,).

    member: (c, a) rows of n tracks; present: (c, a) which count, at least one in each cluster
    """
    count = present.sum(axis=1)
    # Summed by agent, so that rounding does not depend on the order of the rows.
    double = np.where(present[..., None], np.stack([np.cos(2.0 * yaw), np.sin(2.0 * yaw)], axis=-1)[member], 0.0)
    east, north = (double.sum(axis=1) / count[:, None]).T
    values = np.concatenate([position, velocity, size], axis=1)
    ordered = np.sort(np.where(present[..., None], values[member], np.inf), axis=1)
    low, high = ((count - 1) // 2)[:, None, None], (count // 2)[:, None, None]
    middle = 0.5 * (np.take_along_axis(ordered, low, axis=1) + np.take_along_axis(ordered, high, axis=1))[:, 0]
    return middle[:, :3].copy(), middle[:, 3:6].copy(), middle[:, 6:].copy(), 0.5 * np.arctan2(north, east)
