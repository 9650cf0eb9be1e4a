"""One order for the rows of object states that does not depend on how they arrived."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Ints, ObjectStates


def canonical_order(objects: ObjectStates, source: Ints | None = None) -> Ints:
    """(n,) row indices that sort the objects by what they are: position, velocity, size, yaw, score, class, id.

    The id comes after everything physical because objects taken from detections only have row numbers for
    ids. `source` (n,), if given, breaks the last ties. Draws and matches made in this order are the same for
    every permutation of the rows.
    """
    o = objects
    by_x = o.position[:, 0].argsort(kind="stable")
    x = o.position[:, 0].take(by_x)
    if (x[1:] != x[:-1]).all():
        return by_x  # mostly, and then the other keys decide nothing
    keys = [*o.position.T, *o.velocity.T, *o.size.T, o.yaw, o.score, o.class_id, o.id]
    if source is not None:
        keys.append(source)
    return np.lexsort(keys[::-1]).astype(np.int64)
