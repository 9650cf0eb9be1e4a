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

    def at(self, time_ns: int) -> dict[str, ObjectStates]:
        """The tracks of each sender, predicted to a time; by name, sorted."""
        self._known = {
            sender: known for sender, known in self._known.items() if abs(time_ns - known[0]) <= self._max_age_ns
        }
        result = {}
        for sender in sorted(self._known):
            _, states, times = self._known[sender]
            young = np.abs(time_ns - times) <= self._max_age_ns
            result[sender] = _at(time_ns, states.select(young), times[young])
        return result

    def raw(self) -> list[tuple[ObjectStates, Ints]]:
        """The tracks as they were heard, and the time of each, ns, of all senders in the order of their names."""
        return [self._known[sender][1:] for sender in sorted(self._known)]


def _at(time_ns: int, states: ObjectStates, times: Ints) -> ObjectStates:
    """n tracks with times (n,) ns, predicted to one."""
    distinct = np.unique(times)
    parts = [predicted(states.select(times == each), (time_ns - int(each)) * 1e-9) for each in distinct]
    return concatenate(parts)
