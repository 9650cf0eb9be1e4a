"""Velocities of recorded objects whose data set has none."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints


def fill_velocity(ids: Ints, position: Floats, velocity: Floats, times_ns: Ints) -> Floats:
    """`velocity` (N, 3) m/s with its NaN rows taken from how `position` (N, 3) m of the same id changes over time.

    ids (N,) and times_ns (N,) ns, ascending for each id. Central differences, one-sided at the ends of a track; zero
    for an object that is there in one frame only.
    """
    filled = velocity.copy()
    missing = np.logical_or.reduce(np.isnan(velocity), axis=1)
    order = np.argsort(ids, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(ids[order])) + 1):
        if missing[rows].any():
            moved = (
                np.gradient(position[rows], (times_ns[rows] - times_ns[rows[0]]) / 1e9, axis=0)
                if len(rows) > 1
                else np.zeros((1, 3))
            )
            filled[rows[missing[rows]]] = moved[missing[rows]]
    return filled
