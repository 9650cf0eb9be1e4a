"""Ids of the mission estimate, which stay with an object while its sources change."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.states import Bools, Floats, Ints

#: ns after which an id that neither source has is forgotten: as long as the trackers remember (their `max_coast_s`).
FORGOTTEN_NS = 3_000_000_000
#: ns for which an object that both sources have lost may continue under a new id of theirs: constant velocity predicts
#: a car to within about a metre (`tracking.classes`).
RESUMED_NS = 1_000_000_000
#: Estimates in a row for which an own track and an object of the picture must be together before the picture's object
#: continues as the own track did.
SETTLED_AFTER = 5

#: In place of an id: the object is not in this source.
NONE = -1

#: x and y, m or m/s, world frame.
_Vector = tuple[float, float]


@dataclass(slots=True)
class _Known:
    """The id in the estimate of an object of one source, when it was last there, and its new partner, if any."""

    id: int
    time_ns: int
    partner: int = NONE
    together: int = 0


@dataclass(frozen=True, slots=True)
class _Estimate:
    """The n objects of one estimate: arguments and result of `Identities.assign`."""

    time_ns: int
    own: Ints
    picture: Ints
    position: Floats
    velocity: Floats
    ids: Ints


class Identities:
    """Gives the objects of an estimate ids, from those that they have as own tracks and in the picture.

    An object keeps its id when the picture loses it or takes it over. Where the two sources have had different ids for
    what now is one object, it keeps that of the own track: the picture cannot change the identity of what the agent
    sees itself. Where they have had the same id for what now are two objects, it stays with the one nearer to where the
    object should be.

    radius: m, how far from there an object may be that continues with an id although its sources have new ones
    """

    def __init__(self, radius: float) -> None:
        self.radius = radius
        self._own: dict[int, _Known] = {}
        self._picture: dict[int, _Known] = {}
        self._last: dict[int, tuple[int, _Vector, _Vector]] = {}  # of each id: time, ns, position and velocity
        self._next = 0
        self._newest: _Estimate | None = None  # not yet in the dictionaries
        self._ids: tuple[dict[int, int], dict[int, int]] = ({}, {})  # of the names of both sources

    def same(self, own: Ints, picture: Ints) -> Bools:
        """Whether each of p own tracks last had the same id in the estimate as an object of the picture: (p,)."""
        of_own, of_picture = self._ids
        pairs = zip(own.tolist(), picture.tolist(), strict=True)
        return np.array([one in of_own and of_own[one] == of_picture.get(other) for one, other in pairs], bool)

    def assign(self, time_ns: int, own: Ints, picture: Ints, position: Floats, velocity: Floats) -> Ints:
        """Ids (n,) of n objects at a time. Independent of their order.

        own, picture: (n,) id of each as an own track, and in the picture; NONE: it is not in that source
        position, velocity: (n, 2) m and m/s, world frame
        """
        ids = self._as_before(own, picture)
        if ids is None:
            self._remember()
            self._forget(time_ns)
            ids = self._decided(time_ns, own, picture, position)
            self._newest = _Estimate(time_ns, own, picture, position, velocity, ids)
            self._remember()
            of_own, of_picture = (
                {name: known.id for name, known in source.items()} for source in (self._own, self._picture)
            )
            self._ids = of_own, of_picture
            return ids
        if self._newest is not None and not np.array_equal(ids, self._newest.ids):
            self._remember()  # an object may have left
        self._newest = _Estimate(time_ns, own, picture, position, velocity, ids)
        return ids

    def _as_before(self, own: Ints, picture: Ints) -> Ints | None:
        """The ids, in the usual case: both sources have known objects only, and agree about them."""
        of_own, of_picture = self._ids
        names, others = own.tolist(), picture.tolist()
        ids = [of_own.get(name, NONE) for name in names]
        for row, other in enumerate(others):
            if other != NONE:
                known = of_picture.get(other, NONE)
                if ids[row] != known:
                    if names[row] != NONE:
                        return None
                    ids[row] = known
        return None if NONE in ids or len(set(ids)) < len(ids) else np.array(ids, np.int64)

    def _decided(self, time_ns: int, own: Ints, picture: Ints, position: Floats) -> Ints:
        """The ids in any case, one by one: first of the objects that are where their id should be."""
        names = list(zip(own.tolist(), picture.tolist(), strict=True))
        places: list[_Vector] = position.tolist()
        known = [self._known(*each) for each in names]
        away = [self._away(time_ns, k[0], place) if k else math.inf for k, place in zip(known, places, strict=True)]
        ids = [NONE] * len(names)
        taken: set[int] = set()
        for row in sorted(range(len(names)), key=lambda row: (away[row], names[row])):
            ids[row] = next((each for each in known[row] if each not in taken), NONE)
            if ids[row] == NONE:
                ids[row] = self._lost(time_ns, places[row], taken.union(*known))
            taken.add(ids[row])
        return np.array(ids, np.int64)

    def _known(self, own: int, picture: int) -> list[int]:
        """The ids that an object's sources had, the own track's first."""
        sources = (self._own.get(own), self._picture.get(picture))
        return list(dict.fromkeys(each.id for each in sources if each is not None))

    def _away(self, time_ns: int, id_: int, place: _Vector) -> float:
        """m, how far a place is from where the object with an id should be."""
        last_ns, (x, y), (vx, vy) = self._last[id_]
        elapsed_s = (time_ns - last_ns) * 1e-9
        return math.hypot(x + vx * elapsed_s - place[0], y + vy * elapsed_s - place[1])

    def _lost(self, time_ns: int, place: _Vector, others: set[int]) -> int:
        """The id of the nearest object that has just been lost and should be here, or else a new id."""
        lost = [
            (self._away(time_ns, id_, place), id_)
            for id_, (last_ns, _, _) in self._last.items()
            if id_ not in others and time_ns - last_ns <= RESUMED_NS
        ]
        away, id_ = min(lost, default=(math.inf, NONE))
        if away <= self.radius:
            return id_
        self._next += 1
        return self._next - 1

    def _remember(self) -> None:
        """Take the newest estimate into the dictionaries."""
        newest, self._newest = self._newest, None
        if newest is None:
            return
        columns = (newest.own, newest.picture, newest.ids, newest.position, newest.velocity)
        for own, picture, id_, place, speed in zip(*(column.tolist() for column in columns), strict=True):
            self._last[id_] = (newest.time_ns, place, speed)
            if own != NONE:
                self._own[own] = _Known(id_, newest.time_ns)
            if picture != NONE:
                self._picture[picture] = self._continued(newest.time_ns, picture, id_, own)

    def _continued(self, time_ns: int, picture: int, id_: int, own: int) -> _Known:
        """What is known of an object of the picture that has an id now, with an own track or without."""
        known = self._picture.get(picture)
        if known is None or own == NONE or known.id == id_:
            return _Known(id_, time_ns)
        together = known.together + 1 if known.partner == own else 1
        settled = together >= SETTLED_AFTER
        return _Known(id_, time_ns) if settled else _Known(known.id, time_ns, own, together)

    def _forget(self, time_ns: int) -> None:
        """Forget what neither source has had for long."""
        limit = time_ns - FORGOTTEN_NS
        for source in (self._own, self._picture):
            for name in [name for name, known in source.items() if known.time_ns < limit]:
                del source[name]
        kept = {known.id for source in (self._own, self._picture) for known in source.values()}
        for id_ in [id_ for id_, (last_ns, _, _) in self._last.items() if last_ns < limit and id_ not in kept]:
            del self._last[id_]
