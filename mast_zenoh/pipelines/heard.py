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
        self._known: dict[str, tuple[int, ObjectStates, Ints]] = {}  # ns of the newest, n tracks, time of each, ns

    def add(self, sender: str, time_ns: int, states: ObjectStates) -> None:
        """Add a message; a second one about the same time, and an older one, are not used.

        states: n tracks at `time_ns`, world frame, with different ids
        """
        times = np.full(len(states), time_ns)
        if sender in self._known:
            newest_ns, before, before_ns = self._known[sender]
            if time_ns <= newest_ns:
                return
            if self._memory_ns:
                kept = ~np.isin(before.id, states.id) & (time_ns - before_ns <= self._memory_ns)
                states, times = concatenate([states, before.select(kept)]), np.concatenate([times, before_ns[kept]])
        self._known[sender] = time_ns, states, times

    def at(self, time_ns: int) -> tuple[list[str], ObjectStates, Ints]:
        """Names of the senders, sorted; n tracks of all, predicted to a time; and (n,) rows of the senders."""
        self._known = {
            sender: known for sender, known in self._known.items() if abs(time_ns - known[0]) <= self._max_age_ns
        }
        names = sorted(self._known)
        known = [self._known[name] for name in names]
        states = concatenate([each for _, each, _ in known])
        sender = np.repeat(np.arange(len(names)), [len(each) for _, each, _ in known])
        age_ns = time_ns - np.concatenate([np.zeros(0, np.int64), *(times for _, _, times in known)])
        young = np.abs(age_ns) <= self._max_age_ns
        if not young.all():
            states, sender, age_ns = states.select(young), sender[young], age_ns[young]
        groups = [np.flatnonzero(age_ns == age) for age in np.unique(age_ns)]
        parts = [predicted(states.select(rows), float(age_ns[rows[0]]) * 1e-9) for rows in groups]
        if len(parts) > 1:
            states = concatenate(parts).select(np.argsort(np.concatenate(groups)))
        return names, parts[0] if len(parts) == 1 else states, sender
