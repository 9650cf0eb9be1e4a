"""Medians of columns, of groups, and of the members of clusters."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.kernels import kernel


def column_medians(values: Floats | Ints) -> Floats:
    """(q,) medians of the numbers in each column (k, q); NaN for a column without any."""
    if not len(values):
        return np.full(values.shape[1], np.nan)
    ordered, count = np.sort(values, axis=0), (~np.isnan(values)).sum(axis=0)  # NaN are the last
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(values) - 1)
    column = np.arange(values.shape[1])
    return np.asarray(0.5 * (ordered[low, column] + ordered[high, column]))


def group_medians(values: Floats, group: Ints) -> Floats:
    """(g, k) medians of the columns of values (n, k) in each of g groups that occur. group: (n,) >= 0"""
    count = np.bincount(group)
    count = count[count > 0]
    first = np.cumsum(count) - count
    low, high = first + (count - 1) // 2, first + count // 2
    ordered = np.column_stack([column[np.lexsort((column, group))] for column in values.T])
    return np.asarray(0.5 * (ordered[low] + ordered[high]))


@kernel
def weighted_medians(values: Floats, member: Ints, weight: Floats) -> Floats:
    """(c, q) weighted medians of the values of the members of clusters, the middle of their ends where they differ.

    values: (n, q) of n tracks; member: (c, a) rows of tracks; weight: (c, a) >= 0, of each member
    """
    table = values[member].transpose(0, 2, 1)
    order = np.argsort(table, axis=2, kind="stable")
    ordered = np.take_along_axis(table, order, axis=2)
    below = np.cumsum(np.take_along_axis(np.broadcast_to(weight[:, None], table.shape), order, axis=2), axis=2)
    half = 0.5 * below[..., -1:]
    ends = [(below >= half * (1.0 - 1e-9)).argmax(axis=2), (below > half * (1.0 + 1e-9)).argmax(axis=2)]
    low, high = (np.take_along_axis(ordered, end[..., None], axis=2)[..., 0] for end in ends)
    return np.asarray(0.5 * (low + high))
