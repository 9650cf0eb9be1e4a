"""Ids of the mission estimate, which stay with an object while its sources change."""

from __future__ import annotations

import math
from collections import Counter
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


@dataclass(frozen=True, slots=True)
class _Estimate:
    """The n objects of one estimate: arguments and result of `Identities.assign`."""

    time_ns: int
    own: list[int]
    picture: list[int]
    position: Floats
    velocity: Floats
    ids: list[int]


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
        self._own = _Names()
        self._picture = _Names()
        self._partners: dict[int, tuple[int, int]] = {}  # of objects of the picture: an own track, and for how long
        self._lost: dict[int, tuple[int, Floats, Floats]] = {}  # by id: time, ns, position and velocity
        self._newest = _Estimate(0, [], [], np.zeros((0, 2)), np.zeros((0, 2)), [])
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
        names, others, before = own.tolist(), picture.tolist(), self._newest
        ids, unclear = self._known(names, others)
        if unclear:
            self._decide(time_ns, names, others, position, ids, unclear)
        self._newest = _Estimate(time_ns, names, others, position, velocity, ids)
        if unclear or names != before.own or others != before.picture:
            self._note_lost(before)
            self._own.note_gone(before.time_ns, before.own, names)
            self._picture.note_gone(before.time_ns, before.picture, others)
            self._forget(time_ns - FORGOTTEN_NS)
        return np.array(ids, np.int64)

    def _known(self, own: list[int], picture: list[int]) -> tuple[list[int], list[int]]:
        """The ids that the objects had, and the rows that are unclear: new ones, and those with different ids."""
        of_own, of_picture = self._own.ids, self._picture.ids
        ids, unclear = [], []
        for row, (name, other) in enumerate(zip(own, picture, strict=True)):
            known = of_picture.get(other, NONE)
            id_ = known if name == NONE else of_own.get(name, NONE)
            if id_ == NONE or (other != NONE and known != id_):
                unclear.append(row)
            ids.append(id_)
        if len(set(ids)) < len(ids):
            count = Counter(ids)  # new objects have none in common, but are unclear already
            unclear = [row for row, id_ in enumerate(ids) if count[id_] > 1 or row in unclear]
        return ids, unclear

    def _decide(
        self, time_ns: int, own: list[int], picture: list[int], position: Floats, ids: list[int], unclear: list[int]
    ) -> None:
        """Set the ids of the unclear rows, first of the objects that are where their id should be."""
        choices = {
            row: [
                each for each in (self._own.ids.get(own[row]), self._picture.ids.get(picture[row])) if each is not None
            ]
            for row in unclear
        }
        away = {row: self._away(time_ns, c[0], position[row]) if c else math.inf for row, c in choices.items()}
        taken = {id_ for row, id_ in enumerate(ids) if row not in choices}
        for row in sorted(unclear, key=lambda row: (away[row], own[row], picture[row])):
            id_ = next((each for each in choices[row] if each not in taken), NONE)
            if id_ == NONE:
                id_ = self._resumed(time_ns, position[row], taken.union(*choices.values()))
            ids[row] = id_
            taken.add(id_)
        for row in unclear:
            if own[row] != NONE:
                self._own.ids[own[row]] = ids[row]
            if picture[row] != NONE:
                self._continue(picture[row], own[row], ids[row])

    def _continue(self, picture: int, own: int, id_: int) -> None:
        """Let an object of the picture, with an own track or without, have an id, at once or after some time."""
        known = self._picture.ids.get(picture, id_)
        if own != NONE and known != id_:
            partner, together = self._partners.get(picture, (NONE, 0))
            together = together + 1 if partner == own else 1
            if together < SETTLED_AFTER:
                self._partners[picture] = own, together
                return
        self._partners.pop(picture, None)
        self._picture.ids[picture] = id_

    def _away(self, time_ns: int, id_: int, position: Floats) -> float:
        """m, how far a position (2,) is from where the object with an id should be."""
        newest = self._newest
        if id_ in self._lost:
            last_ns, place, velocity = self._lost[id_]
        elif id_ in newest.ids:
            row = newest.ids.index(id_)
            last_ns, place, velocity = newest.time_ns, newest.position[row], newest.velocity[row]
        else:
            return math.inf
        return float(np.hypot(*(place + velocity * ((time_ns - last_ns) * 1e-9) - position)))

    def _resumed(self, time_ns: int, position: Floats, others: set[int]) -> int:
        """The id of the nearest object that has just been lost and should be here, or else a new id."""
        newest = self._newest
        gone = {id_ for id_, (last_ns, _, _) in self._lost.items() if time_ns - last_ns <= RESUMED_NS}
        gone |= set(newest.ids) if time_ns - newest.time_ns <= RESUMED_NS else set()
        away, id_ = min(((self._away(time_ns, id_, position), id_) for id_ in gone - others), default=(math.inf, NONE))
        if away <= self.radius:
            return id_
        self._next += 1
        return self._next - 1

    def _note_lost(self, before: _Estimate) -> None:
        """Remember where the objects were that the newest estimate no longer has."""
        present = set(self._newest.ids)
        for row, id_ in enumerate(before.ids):
            if id_ not in present:
                self._lost[id_] = before.time_ns, before.position[row], before.velocity[row]
        for id_ in present & self._lost.keys():
            del self._lost[id_]

    def _forget(self, limit_ns: int) -> None:
        """Forget what has been gone since before a time."""
        self._own.forget(limit_ns)
        for name in self._picture.forget(limit_ns):
            self._partners.pop(name, None)
        for id_ in [id_ for id_, (last_ns, _, _) in self._lost.items() if last_ns < limit_ns]:
            del self._lost[id_]


class _Names:
    """The ids in the estimate of the objects of one source, by their ids there, their names."""

    def __init__(self) -> None:
        self.ids: dict[int, int] = {}
        self._gone: dict[int, int] = {}  # since when, ns

    def note_gone(self, time_ns: int, before: list[int], now: list[int]) -> None:
        """Remember which names are gone since a time, and which are back."""
        present = set(now)
        self._gone |= dict.fromkeys(set(before) - present - {NONE}, time_ns)
        for name in present & self._gone.keys():
            del self._gone[name]

    def forget(self, limit_ns: int) -> list[int]:
        """Forget the names that have been gone since before a time, and return them."""
        names = [name for name, since_ns in self._gone.items() if since_ns < limit_ns]
        for name in names:
            del self._gone[name], self.ids[name]
        return names
