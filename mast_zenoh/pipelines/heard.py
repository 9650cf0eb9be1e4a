"""What an agent has heard from others: the newest tracks of each, at any later time."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Ints, ObjectStates, concatenate
from mast_zenoh.gather import MAX_AGE_S
from mast_zenoh.tracking.kalman import predicted


class HeardTracks:
    """The newest tracks of each sender.

    memory_s: how long an object is kept that a newer message of its sender left out, as generation rules do; 0: not at
        all, a message has all objects of its sender
    max_age_s: the greatest age of a track that is used
    """

    def __init__(self, memory_s: float = 0.0, max_age_s: float = MAX_AGE_S) -> None:
        for name, value in (("memory_s", memory_s), ("max_age_s", max_age_s)):
            if not 0.0 <= value < float("inf"):
                raise ValueError(f"{name}: found {value}, expected 0 or more")
        self._memory_ns, self._max_age_ns = round(memory_s * 1e9), round(max_age_s * 1e9)
        self._newest: dict[str, int] = {}  # time of the newest message of each sender, ns
        self._known: list[tuple[str, int, ObjectStates]] = []  # sender, time, tracks: newer ones of a sender come last

    def add(self, sender: str, time_ns: int, states: ObjectStates) -> None:
        """Add a message; a second one about the same time, and an older one, are not used.

        states: n tracks at `time_ns`, world frame, with different ids
        """
        if time_ns > self._newest.get(sender, time_ns - 1):
            self._newest[sender] = time_ns
            self._known.append((sender, time_ns, states))

    def at(self, time_ns: int) -> tuple[list[str], ObjectStates, Ints]:
        """Names of the senders, sorted; n tracks of all, predicted to a time; and (n,) rows of the senders.

        Those of a sender are sorted by time, the newest first, and then as in their messages.
        """
        newest = self._newest = {
            sender: newest for sender, newest in self._newest.items() if abs(time_ns - newest) <= self._max_age_ns
        }
        self._known = [
            known for known in self._known if known[0] in newest and newest[known[0]] - known[1] <= self._memory_ns
        ]
        names = sorted(newest)
        row_of = {name: row for row, name in enumerate(names)}
        ordered = sorted(self._known, key=lambda known: (known[0], -known[1]))
        counts = [len(states) for _, _, states in ordered]
        states = concatenate([each for _, _, each in ordered])
        sender = np.repeat(np.array([row_of[each] for each, _, _ in ordered], np.int64), counts)
        age_ns = np.repeat(np.array([time_ns - each for _, each, _ in ordered], np.int64), counts)
        used = np.abs(age_ns) <= self._max_age_ns
        if len(ordered) > len(names):  # an object in several messages: the newest counts
            by_object = np.lexsort((states.id, sender))  # stable: of one object, the newest comes first
            again = np.zeros(len(states), bool)
            again[by_object[1:]] = (np.diff(states.id[by_object]) == 0) & (np.diff(sender[by_object]) == 0)
            used &= ~again
        if not used.all():
            states, sender, age_ns = states.select(used), sender[used], age_ns[used]
        groups = [np.flatnonzero(age_ns == age) for age in np.unique(age_ns)]
        parts = [predicted(states.select(rows), float(age_ns[rows[0]]) * 1e-9) for rows in groups]
        if len(parts) > 1:
            states = concatenate(parts).select(np.argsort(np.concatenate(groups)))
        return names, parts[0] if len(parts) == 1 else states, sender
