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
        self._row: dict[tuple[int, int], int] = {}  # by (agent, track id)
        self._sum = np.zeros((0, self._width))
        self._time_ns = np.zeros(0, np.int64)
        self._most = min(100, self._limit)  # tracks from which the oldest are forgotten

    def forget(self, agent: int) -> None:
        """Forget the tracks of an agent."""
        self._keep([(key, row) for key, row in self._row.items() if key[0] != agent])

    def add(self, time_ns: int, agent: Ints, track: Ints, values: Floats) -> Floats:
        """Add `values` (k, width) and return the sums (k, width).

        agent: (k,) numbers of agents that never change; track: (k,) ids, no (agent, track) twice
        """
        keys = zip(agent.tolist(), track.tolist(), strict=True)
        rows = np.array([self._row.setdefault(key, len(self._row)) for key in keys], np.int64)
        new = len(self._row) - len(self._sum)
        self._sum = np.concatenate([self._sum, np.zeros((new, self._width))])
        self._time_ns = np.concatenate([self._time_ns, np.full(new, time_ns)])
        age_s = (time_ns - self._time_ns[rows]) * 1e-9
        total: Floats = self._sum[rows] * np.exp(-age_s / self._memory_s)[:, None] + values
        self._sum[rows], self._time_ns[rows] = total, time_ns
        if len(self._row) > self._most:
            oldest_ns = time_ns - round(10 * self._memory_s * 1e9)
            newest = sorted(self._row.items(), key=lambda item: -self._time_ns[item[1]])[: self._limit]
            self._keep([(key, row) for key, row in newest if self._time_ns[row] >= oldest_ns])
            self._most = min(2 * len(self._row) + 100, self._limit)
        return total

    def _keep(self, kept: list[tuple[tuple[int, int], int]]) -> None:
        rows = np.array([row for _, row in kept], np.int64)
        self._row = {key: row for row, (key, _) in enumerate(kept)}
        self._sum, self._time_ns = self._sum[rows], self._time_ns[rows]
