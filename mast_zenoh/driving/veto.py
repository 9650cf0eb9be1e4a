"""The veto of own sensors: a driver believes its agent's own tracks, and of what others report only what fits them."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.matching import greedy_matching, neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints, ObjectStates, concatenate

#: m, in the bird's-eye view, between an own track and the object of the mission estimate that it stands for at most:
#: the radius within which agents pair the two.
SAME_OBJECT_M = 2.0
#: s, for which own sensors remember that they saw through an object: of what is close to the car, too little is in view
#: now and then.
REFUTED_S = 1.0


class Refutations:
    """Which objects of a mission estimate own sensors see through, or did of late."""

    def __init__(self) -> None:
        self._until_ns: dict[int, int] = {}  # by id of the object

    def update(self, time_ns: int, ids: Ints, free: Bools) -> Bools:
        """(n,) whether the places of the objects with these ids are free, or were within REFUTED_S.

        free: (n,) whether own sensors see through them now; times must not fall
        """
        self._until_ns = {id_: until_ns for id_, until_ns in self._until_ns.items() if until_ns >= time_ns}
        self._until_ns |= dict.fromkeys(ids[free].tolist(), time_ns + round(REFUTED_S * 1e9))
        return np.array([id_ in self._until_ns for id_ in ids.tolist()], np.bool_)


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
    free:    (m,) whether its sensors see through the place of each of these, see `Refutations`

    All own tracks count, whether or not the mission estimate has them. An object of the mission estimate counts where
    no own track stands for it (each track for one object at most, the nearest pairs first), unless its place is free.
    Ids are those of the mission estimate, and -1 - id for own tracks, so that they are unique.
    """
    others = mission.select(upheld(own.position, mission.position, free))
    return concatenate([own.with_(id=-1 - own.id), others])
