"""Velocities and headings of recorded objects from data sets that store none."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints

_STANDING_MPS = 0.5  # the direction of a lower speed is mostly noise


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


def direction_of_motion(ids: Ints, velocity: Floats) -> Floats:
    """(N,) rad, direction of velocities (N, 3) m/s, ascending in time for each id (N,).

    While an object stands, its last direction, or its first before it moves; 0 for one that never does.
    """
    moving = np.hypot(velocity[:, 0], velocity[:, 1]) > _STANDING_MPS
    direction = np.where(moving, np.arctan2(velocity[:, 1], velocity[:, 0]), 0.0)
    order = np.argsort(ids, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(ids[order])) + 1):
        known = np.flatnonzero(moving[rows])
        if len(known):
            last = np.searchsorted(known, np.arange(len(rows)), side="right") - 1
            direction[rows] = direction[rows[known[np.maximum(last, 0)]]]
    return direction
