"""The veto of own sensors: a driver believes its agent's own tracks, and of what others report only what fits them."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.matching import greedy_matching, neighbours
from mast_zenoh.arrays.states import Bools, Floats, ObjectStates, concatenate

#: m, in the bird's-eye view, between an own track and the object of the mission estimate that it stands for at most:
#: the radius within which agents pair the two.
SAME_OBJECT_M = 2.0


def upheld(own: Floats, mission: Floats, free: Bools) -> Bools:
    """Which objects of the mission estimate count beside own tracks: (m,).

    own: (n, 3) m, positions of own tracks; mission: (m, 3) m, of the objects; free: (m,), see `overruled`
    """
    i, j, dx, dy = neighbours(own, mission, np.full(len(own), SAME_OBJECT_M))
    others = ~free
    others[j[greedy_matching(i, j, np.hypot(dx, dy))]] = False
    return others


def overruled(own: ObjectStates, mission: ObjectStates, free: Bools) -> ObjectStates:
    """The objects to drive by: own tracks, and the objects of the mission estimate that own sensors do not refute.

    own:     n own tracks, from the agent's sensors alone
    mission: m objects of its mission estimate, at the same time
    free:    (m,) whether its sensors see through the place of each of these

    All own tracks count, whether or not the mission estimate has them. An object of the mission estimate counts where
    no own track stands for it (each track for one object at most, the nearest pairs first), unless its place is free.
    Ids are those of the mission estimate, and -1 - id for own tracks, so that they are unique.
    """
    others = mission.select(upheld(own.position, mission.position, free))
    return concatenate([own.with_(id=-1 - own.id), others])
