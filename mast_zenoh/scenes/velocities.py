"""Velocities of recorded objects from data sets that store none."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints


def fill_velocity(ids: Ints, position: Floats, velocity: Floats, times_ns: Ints) -> Floats:
    """Fill NaN rows of `velocity` (N, 3) m/s by differentiating `position` (N, 3) m.

    ids (N,) and times_ns (N,) ns, ascending for each id. Central differences, one-sided at the ends of a track; zero
    for an object in a single frame.
    """
    filled = velocity.copy()
    missing = np.logical_or.reduce(np.isnan(velocity), axis=1)
    order = np.argsort(ids, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(ids[order])) + 1):
        if missing[rows].any():
            derivative = (
                np.gradient(position[rows], (times_ns[rows] - times_ns[rows[0]]) / 1e9, axis=0)
                if len(rows) > 1
                else np.zeros((1, 3))
            )
            filled[rows[missing[rows]]] = derivative[missing[rows]]
    return filled
