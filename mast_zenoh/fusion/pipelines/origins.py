"""From which agents' sensors the objects of a picture come."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mast_zenoh.arrays.states import Bools, Ints


class Origins:
    """The agents whose tracks have ever been in each object of a picture.

    A tracker remembers: an object keeps its origins as long as it is in the picture.
    """

    def __init__(self) -> None:
        self._names: tuple[str, ...] = ()
        self._ids = np.zeros(0, np.int64)
        self._origins = np.zeros((0, 0), np.bool_)

    def update(self, ids: Ints, members: Ints, of_members: Bools, names: Sequence[str]) -> Bools:
        """(n, a) whether each of a agents is an origin of each of n objects, after one more step.

        ids: (n,) of the picture, ascending; members: (m,) the row of its object for each track of the step, -1: none
        of_members: (m, a) origins of these tracks; names: of the a agents, sorted
        """
        origins = np.zeros((len(ids), len(names)), np.bool_)
        if len(self._ids):
            place = np.minimum(np.searchsorted(self._ids, ids), len(self._ids) - 1)
            known = self._ids[place] == ids
            columns = [names.index(name) for name in self._names if name in names]
            kept = [column for column, name in enumerate(self._names) if name in names]
            origins[np.ix_(known.nonzero()[0], columns)] = self._origins[place[known]][:, kept]
        used = members >= 0
        np.logical_or.at(origins, members[used], of_members[used])
        self._names, self._ids, self._origins = tuple(names), ids, origins
        return origins
