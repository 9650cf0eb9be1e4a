"""Radius search between point sets."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.kernels import kernel

#: Number of pairs up to which all are compared.
MAX_TABLE = 250_000

#: Limit on the neighbours of a point above that. No street holds more road users within a few metres, and objects that
#: a hostile source puts in one place must not fill the memory.
MAX_NEIGHBOURS = 64


def neighbours(a: Floats, b: Floats, radius: Floats) -> tuple[Ints, Ints, Floats, Floats]:
    """Pairs of `a` (n,) and `b` (m,) at most `radius` (n,) m apart, sorted by a, b.

    a, b: (n, >= 2), (m, >= 2) m; only x and y count
    Returns rows of a (p,), rows of b (p,), and how far b is from a in x and in y (p,) m.
    """
    if len(a) * len(b) > MAX_TABLE:
        return _nearest(a[:, :2], b[:, :2], radius)
    return pairs_within_radius(a, b, radius)


@kernel
def pairs_within_radius(a: Floats, b: Floats, radius: Floats) -> tuple[Ints, Ints, Floats, Floats]:
    """See `neighbours`."""
    m = len(b)
    dx = b[:, 0] - a[:, 0, None]
    dy = b[:, 1] - a[:, 1, None]
    pair = (dx * dx + dy * dy <= (radius * radius)[:, None]).ravel().nonzero()[0]
    i = pair // max(m, 1)
    return i, pair - i * m, dx.take(pair), dy.take(pair)


def _nearest(a: Floats, b: Floats, radius: Floats) -> tuple[Ints, Ints, Floats, Floats]:
    """As `neighbours`, with at most MAX_NEIGHBOURS in `b` for each point in `a`."""
    from scipy.spatial import cKDTree  # slow to load, and few nodes ever see so many pairs

    count = min(MAX_NEIGHBOURS, len(b))
    # A little further than the radius, so that rounding in the tree has no effect.
    _, other = cKDTree(b).query(a, np.arange(1, count + 1), distance_upper_bound=float(radius.max()) * (1.0 + 1e-9))
    other = np.sort(np.asarray(other, np.int64), axis=1).ravel()
    valid = (other < len(b)).nonzero()[0]
    i, j = valid // count, other[valid]
    dx, dy = (b[j] - a[i]).T
    inside = dx * dx + dy * dy <= (radius * radius)[i]
    return i[inside], j[inside], dx[inside], dy[inside]
