"""What lies near what."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints
from mast_zenoh.kernels import kernel

#: Pairs up to which all are looked at.
TABLE = 250_000

#: Neighbours of one place that are looked at beyond that. No street holds more road users within a few metres, and what
#: a hostile source piles up in one place must not fill the memory.
CROWD = 64


def neighbours(a: Floats, b: Floats, reach: Floats) -> tuple[Ints, Ints, Floats, Floats]:
    """Pairs of n places `a` and m places `b` that lie within `reach` (n,) m of each other, by rows of a, then of b.

    a, b: (n, >= 2), (m, >= 2) m; only x and y count
    Returns rows of a (p,), rows of b (p,), and how far b is from a in x and in y (p,) m.
    """
    if len(a) * len(b) > TABLE:
        return _nearest(a[:, :2], b[:, :2], reach)
    return pairs_within_radius(a, b, reach)


@kernel
def pairs_within_radius(a: Floats, b: Floats, reach: Floats) -> tuple[Ints, Ints, Floats, Floats]:
    """See `neighbours`."""
    m = len(b)
    dx = b[:, 0] - a[:, 0, None]
    dy = b[:, 1] - a[:, 1, None]
    pair = (dx * dx + dy * dy <= (reach * reach)[:, None]).ravel().nonzero()[0]
    i = pair // max(m, 1)
    return i, pair - i * m, dx.take(pair), dy.take(pair)


def _nearest(a: Floats, b: Floats, reach: Floats) -> tuple[Ints, Ints, Floats, Floats]:
    """As `neighbours`, but of each place in `a` only the CROWD nearest in `b`."""
    from scipy.spatial import cKDTree  # slow to load, and few nodes ever see such a crowd

    crowd = min(CROWD, len(b))
    # A little further than the reach, so that rounding in the tree decides nothing.
    _, other = cKDTree(b).query(a, np.arange(1, crowd + 1), distance_upper_bound=float(reach.max()) * (1.0 + 1e-9))
    other = np.sort(np.asarray(other, np.int64), axis=1).ravel()
    found = (other < len(b)).nonzero()[0]
    i, j = found // crowd, other[found]
    dx, dy = (b[j] - a[i]).T
    inside = dx * dx + dy * dy <= (reach * reach)[i]
    return i[inside], j[inside], dx[inside], dy[inside]
