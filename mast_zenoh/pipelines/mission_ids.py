"""Ids of the mission estimate, which stay with an object while its sources change.

Both sources have ids that last (`fusion.returning_objects` sees to that in the picture). What is decided here is which
id of one source is the object of which id of the other.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from mast_zenoh.arrays.matching import greedy_matching
from mast_zenoh.arrays.neighbours import neighbours
from mast_zenoh.arrays.states import Bools, Floats, Ints

#: ns after which an id that neither source has is forgotten: as long as the trackers remember (their `max_coast_s`).
FORGOTTEN_NS = 3_000_000_000
#: ns for which an object that both sources have lost may continue under a new id of theirs: constant velocity predicts
#: a car to within about a metre (`tracking.classes`).
RESUMED_NS = 1_000_000_000
#: Estimates in a row for which an own track and an object of the picture must be together before the picture's object
#: continues as the own track did.
SETTLED_AFTER = 5
#: Largest number of lost objects that are remembered.
MAX_LOST = 1000

#: In place of an id: the object is not in this source.
NONE = -1


@dataclass(frozen=True, slots=True)
class _Estimate:
    """The n objects of one estimate: arguments and result of `MissionIds.assign`, and its number."""

    number: int
    time_ns: int
    own: list[int]
    picture: list[int]
    position: Floats
    velocity: Floats
    ids: list[int]


class MissionIds:
    """Gives the objects of an estimate ids, from those that they have as own tracks and in the picture.

    An object keeps its id when the picture loses it or takes it over. Where the two sources have had different ids for
    what now is one object, it keeps that of the own track: a pairing does not change the identity of what the agent
    sees itself. Where they have had the same id for what now are two objects, it stays with the one nearer to where the
    object should be.

    radius: m, how far from there an object may be that continues with an id although its sources have new ones
    """

    def __init__(self, radius: float) -> None:
        self.radius = radius
        self._own = _IdMap()
        self._picture = _IdMap()
        self._partners: dict[int, tuple[int, int, int]] = {}  # by picture id: own id, for how long, last estimate
        self._lost: dict[int, tuple[int, Floats, Floats]] = {}  # by id: time, ns, position and velocity
        self._newest = _Estimate(0, 0, [], [], np.zeros((0, 2)), np.zeros((0, 2)), [])
        self._settled = False  # the same objects would have the same ids again
        self._next = 0

    def same(self, own: Ints, picture: Ints) -> Bools:
        """Whether each of p own tracks last had the same id in the estimate as an object of the picture: (p,)."""
        of_own, of_picture = self._own.ids, self._picture.ids
        pairs = zip(own.tolist(), picture.tolist(), strict=True)
        return np.array([one in of_own and of_own[one] == of_picture.get(other) for one, other in pairs], bool)

    def assign(self, time_ns: int, own: Ints, picture: Ints, position: Floats, velocity: Floats) -> Ints:
        """Ids (n,) of n objects at a time. Independent of their order.

        own, picture: (n,) id of each as an own track, and in the picture; NONE: it is not in that source
        position, velocity: (n, 2) m and m/s, world frame
        """
        own_ids, picture_ids, before = own.tolist(), picture.tolist(), self._newest
        unchanged = own_ids == before.own and picture_ids == before.picture
        unclear: list[int] = []
        if unchanged and self._settled:
            ids = before.ids
        else:
            self._inherit(own_ids)
            ids, unclear = self._known(own_ids, picture_ids)
            if unclear:
                self._decide(time_ns, own_ids, picture_ids, position, ids, unclear)
            self._settled = not unclear and not self._partners
        self._newest = _Estimate(before.number + 1, time_ns, own_ids, picture_ids, position, velocity, ids)
        if unclear or not unchanged:
            self._note_lost(before)
            self._own.note_gone(before.time_ns, before.own, own_ids)
            self._picture.note_gone(before.time_ns, before.picture, picture_ids)
            self._forget(time_ns - FORGOTTEN_NS)
        return np.array(ids, np.int64)

    def _known(self, own: list[int], picture: list[int]) -> tuple[list[int], list[int]]:
        """The ids that the objects had, and the rows that are unclear: new ones, and those with different ids."""
        of_own, of_picture = self._own.ids, self._picture.ids
        ids, unclear = [], set[int]()
        for row, (own_id, picture_id) in enumerate(zip(own, picture, strict=True)):
            known = of_picture.get(picture_id, NONE)
            id_ = known if own_id == NONE else of_own.get(own_id, NONE)
            if id_ == NONE or (picture_id != NONE and known != id_):
                unclear.add(row)
            ids.append(id_)
        if len(set(ids)) < len(ids):
            count = Counter(ids)
            unclear |= {row for row, id_ in enumerate(ids) if count[id_] > 1}
        return ids, sorted(unclear)

    def _decide(
        self, time_ns: int, own: list[int], picture: list[int], position: Floats, ids: list[int], unclear: list[int]
    ) -> None:
        """Set the ids of the unclear rows, first of the objects that are where their id should be."""
        choices = {row: self._choices(own[row], picture[row]) for row in unclear}
        places = self._predicted(time_ns)
        away = {row: _distance(places.get(c[0]) if c else None, position[row]) for row, c in choices.items()}
        order = sorted(unclear, key=lambda row: (away[row], own[row], picture[row]))
        taken = {id_ for row, id_ in enumerate(ids) if row not in choices}
        for row in order:
            ids[row] = next((id_ for id_ in choices[row] if id_ not in taken), NONE)
            taken.add(ids[row])
        new = [row for row in order if ids[row] == NONE]
        self._resume(position, ids, new, taken.union(*choices.values()), places)
        for row in unclear:
            if own[row] != NONE:
                self._own.ids[own[row]] = ids[row]
            if picture[row] != NONE:
                self._continue(picture[row], own[row], ids[row])

    def _choices(self, own_id: int, picture_id: int) -> list[int]:
        """The ids that an object had, the one that it should keep first."""
        choices = [self._own.ids.get(own_id), self._picture.ids.get(picture_id)]
        if self._own.away(own_id) and not self._picture.away(picture_id):
            choices.reverse()  # the agent has not seen it itself of late
        return [id_ for id_ in choices if id_ is not None]

    def _inherit(self, own: list[int]) -> None:
        """Let objects of the picture whose own track has just been lost continue as it did."""
        if self._partners:
            present, number = set(own), self._newest.number
            for picture_id, (partner, _, last) in list(self._partners.items()):
                if last == number - 1 and partner not in present:
                    self._picture.ids[picture_id] = self._own.ids[partner]
                    del self._partners[picture_id]

    def _predicted(self, time_ns: int) -> dict[int, tuple[float, float, int]]:
        """Where the objects with ids should be now, m, and since when they are unseen, ns."""
        newest = self._newest
        elapsed_s = (time_ns - newest.time_ns) * 1e-9
        moved = (newest.position + newest.velocity * elapsed_s).tolist()
        places = {id_: (x, y, time_ns - newest.time_ns) for id_, (x, y) in zip(newest.ids, moved, strict=True)}
        for id_, (last_ns, position, velocity) in self._lost.items():
            x, y = (position + velocity * ((time_ns - last_ns) * 1e-9)).tolist()
            places[id_] = x, y, time_ns - last_ns
        return places

    def _resume(
        self,
        position: Floats,
        ids: list[int],
        new: list[int],
        others: set[int],
        places: dict[int, tuple[float, float, int]],
    ) -> None:
        """Give new objects the ids of lost ones that should be there, the nearest first, and the others new ids."""
        lost = sorted(id_ for id_, place in places.items() if id_ not in others and place[2] <= RESUMED_NS)
        if new and lost:
            there = np.array([places[id_][:2] for id_ in lost])
            i, j, dx, dy = neighbours(position[new], there, np.full(len(new), self.radius))
            chosen = greedy_matching(i, j, np.hypot(dx, dy))
            for row, which in zip(i[chosen].tolist(), j[chosen].tolist(), strict=True):
                ids[new[row]] = lost[which]
        for row in new:
            if ids[row] == NONE:
                ids[row], self._next = self._next, self._next + 1

    def _continue(self, picture_id: int, own_id: int, id_: int) -> None:
        """Let an object of the picture, with an own track or without, have an id, at once or after some time."""
        known = self._picture.ids.get(picture_id, id_)
        number = self._newest.number
        if own_id != NONE and known != id_:
            partner, together, last = self._partners.get(picture_id, (NONE, 0, number))
            together = together + 1 if partner == own_id and last == number - 1 else 1
            if together < SETTLED_AFTER:
                self._partners[picture_id] = own_id, together, number
                return
        self._partners.pop(picture_id, None)
        self._picture.ids[picture_id] = id_

    def _note_lost(self, before: _Estimate) -> None:
        """Remember where the objects were that the newest estimate no longer has."""
        present = set(self._newest.ids)
        for row, id_ in enumerate(before.ids):
            if id_ not in present and len(self._lost) < MAX_LOST:
                self._lost[id_] = before.time_ns, before.position[row], before.velocity[row]
        for id_ in present & self._lost.keys():
            del self._lost[id_]

    def _forget(self, limit_ns: int) -> None:
        """Forget what has been gone since before a time."""
        self._own.forget(limit_ns)
        for picture_id in self._picture.forget(limit_ns):
            self._partners.pop(picture_id, None)
        for id_ in [id_ for id_, (last_ns, _, _) in self._lost.items() if last_ns < limit_ns]:
            del self._lost[id_]


class _IdMap:
    """The ids in the estimate, by the ids of one source."""

    def __init__(self) -> None:
        self.ids: dict[int, int] = {}
        self._gone: dict[int, int] = {}  # since when, ns

    def away(self, source_id: int) -> bool:
        """Whether the source did not have an object in the newest estimate."""
        return source_id in self._gone

    def note_gone(self, time_ns: int, before: list[int], now: list[int]) -> None:
        """Remember which ids of the source are gone since a time, and which are back."""
        present = set(now)
        self._gone |= dict.fromkeys(set(before) - present - {NONE}, time_ns)
        for source_id in present & self._gone.keys():
            del self._gone[source_id]

    def forget(self, limit_ns: int) -> list[int]:
        """Forget the ids of the source that have been gone since before a time, and return them."""
        forgotten = [source_id for source_id, since_ns in self._gone.items() if since_ns < limit_ns]
        for source_id in forgotten:
            del self._gone[source_id], self.ids[source_id]
        return forgotten


def _distance(place: tuple[float, float, int] | None, position: Floats) -> float:
    """m, from a place to a position (2,)."""
    return math.inf if place is None else math.hypot(place[0] - position[0], place[1] - position[1])
