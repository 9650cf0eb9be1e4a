"""A canonical order of object states, independent of their arrival."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Ints, ObjectStates


def canonical_order(objects: ObjectStates, source: Ints | None = None) -> Ints:
    """(n,) row indices that sort the objects by position, velocity, size, yaw, score, class and id.

    The id comes last because objects from detections only have row numbers as ids. `source` (n,), if given, breaks
    remaining ties. Random draws and matches in this order are the same for every permutation of the rows.
    """
    o = objects
    by_x = o.position[:, 0].argsort(kind="stable")
    x = o.position[:, 0].take(by_x)
    if (x[1:] != x[:-1]).all():
        return by_x  # the usual case, in which no other key matters
    keys = [*o.position.T, *o.velocity.T, *o.size.T, o.yaw, o.score, o.class_id, o.id]
    if source is not None:
        keys.append(source)
    return np.lexsort(keys[::-1]).astype(np.int64)
