"""Sums over time for each track of each agent."""

from __future__ import annotations

import numpy as np

from mast_zenoh.arrays.states import Floats, Ints


class TrackSums:
    """Exponentially forgotten sums of a vector for each (agent, track id).

    width: numbers in the vector; memory_s: s after which a summand has fallen to 1/e
    limit: tracks that are remembered at most; those not seen for longest are forgotten first

    An agent that renumbers its tracks loses their sums, but an honest one does not.
    """

    def __init__(self, width: int, memory_s: float, limit: int = 10_000) -> None:
        self._width = width
        self._memory_s = memory_s
        self._limit = limit
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._key = np.zeros((0, 2), np.int64)
        self._sum = np.zeros((0, self._width))
        self._time_ns = np.zeros(0, np.int64)

    def forget(self, agent: int) -> None:
        """Forget the tracks of an agent."""
        keep = self._key[:, 0] != agent
        self._key, self._sum, self._time_ns = self._key[keep], self._sum[keep], self._time_ns[keep]

    def add(self, time_ns: int, agent: Ints, track: Ints, values: Floats) -> Floats:
        """Add `values` (k, width) and return the sums (k, width).

        agent: (k,) numbers of agents that never change; track: (k,) ids, no (agent, track) twice
        """
        both = np.concatenate([self._key, np.column_stack([agent, track])])
        _, row = np.unique(both, axis=0, return_inverse=True)
        row = row.ravel()
        count = int(row.max()) + 1 if len(row) else 0
        known, new = row[: len(self._key)], row[len(self._key) :]
        key, total, latest = np.empty((count, 2), np.int64), np.zeros((count, self._width)), np.full(count, time_ns)
        key[row] = both
        total[known], latest[known] = self._sum, self._time_ns
        age = (time_ns - latest[new]) * 1e-9
        total[new] = total[new] * np.exp(-age / self._memory_s)[:, None] + values
        latest[new] = time_ns
        keep = np.sort(np.argsort(-latest, kind="stable")[: self._limit])
        keep = keep[time_ns - latest[keep] <= 10 * self._memory_s * 1e9]
        self._key, self._sum, self._time_ns = key[keep], total[keep], latest[keep]
        return total[new]
